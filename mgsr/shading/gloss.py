"""The gloss of a surface: its roughness, whether it is a metal, and the environment that it mirrors.

A glossy surface shows a matte part, which looks the same from all sides, and a mirrored environment map. The roughness
blurs the map (GGX; Walter et al., 2007), and Fresnel's law scales it. Metals and black dielectrics have no matte part.
Fresnel's law distinguishes these two.

A map of blurred light and a rough surface look alike. But a map is nowhere negative, which limits how sharp a rough
surface can look. So the photographs determine the roughness where the environment has lamps or edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, minimize

from mgsr.config.expert import GlossOptions
from mgsr.data.images import srgb_to_linear
from mgsr.data.photograph import Photograph
from mgsr.data.scene import View, some_of
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import reflect
from mgsr.shading.environment_fit import sample_map, steps_squared
from mgsr.shading.material import MATTE, Material
from mgsr.shading.observations import observe_photographs, sample_image

ROUGHNESSES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8)
TILTS = (0.3, 0.6, 1.0)  # cosines of the tilts at which lobes are computed; other tilts blend these lobes

LEAST_TILT, TABLE = 0.02, 50  # the least cosine and the number of cosines at which `mirrored_share` integrates
DRAWS = 32  # microfacets along each of the integral's two axes


@dataclass(frozen=True)
class Mirrorings:
    """Q observations of P points: what each photograph shows of a point.

    owners [Q]: the index of the point.
    directions [Q,3]: the mirrored line of sight, as unit vectors.
    cosines [Q]: the cosine of the surface's tilt.
    colors [Q,3]: the observed linear light.
    weights [Q]: the weight of the observation.
    training [Q] bool: False for observations of held-out photographs.
    """

    owners: np.ndarray
    directions: np.ndarray
    cosines: np.ndarray
    colors: np.ndarray
    weights: np.ndarray
    training: np.ndarray


def mirrorings(
    mesh: Mesh,
    views: Sequence[View],
    gap: float,
    threads: int | None = None,
    options: GlossOptions = GlossOptions(),
) -> Mirrorings:
    """Collect the observations of a mesh's vertices, except where the mirrored ray meets the mesh again.

    gap: the largest depth of a vertex behind the mesh, in the scene's unit.
    """
    photographs = [Photograph(view) for view in some_of(views)]
    observed = observe_photographs(mesh, photographs, gap, threads)
    points = np.flatnonzero(observed.counts >= options.min_observations)
    if len(points) > options.points:
        points = np.sort(np.random.default_rng(0).choice(points, options.points, replace=False))
    observed = observed.at(points)
    owners, seen = np.nonzero(observed.weights > 0)
    normals, eye = mesh.double_normals[points][owners], observed.view_directions[owners, seen].astype(np.float64)
    cosines = (eye * normals).sum(axis=1)
    directions = reflect(eye, normals)
    places = mesh.vertices[points][owners]
    free = ~mesh.caster.cast_rays(places + gap * normals, directions).mask
    numbers = observed.photographs[owners, seen]
    colors = np.zeros((len(owners), 3), np.float32)
    for number, view in enumerate(some_of(views)):
        own = np.flatnonzero(numbers == number)
        pixels, _ = view.camera.project(places[own])
        linear = srgb_to_linear(view.image.astype(np.float32) / 255)
        colors[own] = np.stack([sample_image(linear[..., channel], pixels) for channel in range(3)], axis=1)
    weights = observed.weights[owners, seen]
    held = numbers % options.held_out == options.held_out - 1
    return Mirrorings(*(each[free] for each in (owners, directions, cosines, colors, weights, ~held)))


class Substance(Enum):
    """The material classes of a glossy surface that are compared."""

    DIELECTRIC = "dielectric"
    BLACK_DIELECTRIC = "black dielectric"
    METAL = "metal"


def fit_gloss(seen: Mirrorings, options: GlossOptions = GlossOptions()) -> Material:
    """Fit the material of a glossy surface to its observations; return MATTE if gloss does not explain them better."""
    gray = seen.colors.mean(axis=1)
    if not (gray[seen.training].any() and gray[~seen.training].any()):
        return MATTE
    height, rows = options.height, sample_map(seen.directions, options.height).astype(np.float32)
    dark = np.zeros(2 * height**2)
    fits = [_Fit(seen, rows, substance, options) for substance in Substance]
    lights = [fit.solve(gray, ROUGHNESSES[0], dark, options.first_steps) for fit in fits]
    errors = [fit.deviation(gray, ROUGHNESSES[0], light) for fit, light in zip(fits, lights, strict=True)]
    if min(errors) > options.matte_deviation * fits[0].deviation(gray, ROUGHNESSES[0], dark):
        return MATTE
    chosen = int(np.argmin(errors))
    fit, metallic = fits[chosen], fits[chosen].metallic
    found = _try_roughnesses(fit, gray, lights[chosen], options)
    best = min(deviation for _, deviation, _ in found)
    likely, possible = (
        [each for each in found if each[1] <= limit * best] for limit in (options.likely, options.possible)
    )
    roughness, light = float(np.mean([each[0] for each in likely])), likely[-1][2]
    channels = [fit.solve(seen.colors[:, each], roughness, light, options.steps) for each in range(3)]
    colored = np.stack(channels, axis=1)
    tint, reflectance = None, np.full(3, options.dielectric)
    if metallic:
        mean = fit.spread(colored, roughness).mean(axis=0)
        tint = reflectance = options.metal * mean / mean.max()
    light = (colored / reflectance).reshape(height, 2 * height, 3).astype(np.float32)
    return Material(roughness, (possible[0][0], possible[-1][0]), float(metallic), tint, light)


def _try_roughnesses(
    fit: _Fit, values: np.ndarray, light: np.ndarray, options: GlossOptions
) -> list[tuple[float, float, np.ndarray]]:
    """Return roughnesses in ascending order, each with the deviation of values [Q] and its light [2*height^2].

    light [2*height^2]: the first guess. The search ends once larger roughnesses explain the photographs worse.
    """
    found: list[tuple[float, float, np.ndarray]] = []
    for roughness in ROUGHNESSES:
        light = fit.solve(values, roughness, light, options.steps)
        found.append((roughness, fit.deviation(values, roughness, light), light))
        if found[-1][1] > options.worse * min(deviation for _, deviation, _ in found):
            break
    return found


class _Fit:
    """The equations of one substance."""

    def __init__(self, seen: Mirrorings, rows: sparse.csr_matrix, substance: Substance, options: GlossOptions) -> None:
        """Prepare the fit; rows [Q,2*height^2] sample a map in the mirrored directions."""
        self.metallic = substance is Substance.METAL
        self._matte = substance is Substance.DIELECTRIC
        self._seen, self._options = seen, options
        self._rows = [sparse.diags_array(part.astype(np.float32)) @ rows for part in _hats(seen.cosines)]
        self._turned = [part.T.tocsr() for part in self._rows]
        self._smooth = steps_squared(options.height)
        self._lobes: dict[float, list[GgxLobe]] = {}

    def solve(self, values: np.ndarray, roughness: float, start: np.ndarray, steps: int) -> np.ndarray:
        """Return the non-negative light [2*height^2] that best explains values [Q] of the training photographs.

        The light includes the factor of the reflectance at normal incidence. start [2*height^2]: the first guess.
        steps: the most steps of the optimiser.
        """
        lobes, share = self._lobes_of(roughness), self._share(roughness)
        weights = self._seen.weights * self._seen.training
        prior_weight = self._options.smoothness * weights.sum() / len(start)
        scale = float((weights * values * values).sum()) / len(start)

        def cost(light: np.ndarray) -> tuple[float, np.ndarray]:
            residual = self._centred(values - share * self.spread(light, roughness), weights)
            pull, weighted = self._smooth @ light, share * weights * residual
            slope = -sum(lobe.gather(turned @ weighted) for lobe, turned in zip(lobes, self._turned, strict=True))
            value = 0.5 * float((weights * residual * residual).sum() + prior_weight * (light @ pull))
            return value / scale, (slope + prior_weight * pull) / scale

        options = {"maxiter": steps, "ftol": self._options.tolerance}
        bounds = Bounds(0, np.inf)
        fitted: np.ndarray = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
        return fitted

    def deviation(self, values: np.ndarray, roughness: float, light: np.ndarray) -> float:
        """Return the root mean square residual of values [Q] under a light [2*height^2], in the held-out photographs.

        The matte part of each point is that of the training photographs. Residuals are clipped at `outlier`, because
        the model has no second reflections.
        """
        seen = self._seen
        residual = values - self._share(roughness) * self.spread(light, roughness)
        judged = seen.weights * ~seen.training
        if self._matte:
            training = seen.weights * seen.training
            sums, total = (np.bincount(seen.owners, each) for each in (training * residual, training))
            residual = residual - (sums / np.maximum(total, 1e-9))[seen.owners]
            judged = judged * (total[seen.owners] > 0)
        clipped = np.minimum(residual**2, self._options.outlier**2)
        return float(np.sqrt((judged * clipped).sum() / max(judged.sum(), 1e-9)))

    def spread(self, lights: np.ndarray, roughness: float) -> np.ndarray:
        """Return the light [Q,...] that the observed points mirror of a map `lights` [2*height^2,...]."""
        lobes = self._lobes_of(roughness)
        return np.asarray(sum(rows @ lobe.blur(lights) for rows, lobe in zip(self._rows, lobes, strict=True)))

    def _centred(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Subtract each point's weighted mean from values [Q] if the substance has a matte part; weights [Q]."""
        if not self._matte:
            return values
        owners = self._seen.owners
        mean = np.bincount(owners, weights * values) / np.maximum(np.bincount(owners, weights), 1e-9)
        return np.asarray(values - mean[owners])

    def _share(self, roughness: float) -> np.ndarray:
        """Return the mirrored share [Q] of each observation, divided by the reflectance at normal incidence."""
        if self.metallic:
            return mirrored_share(self._seen.cosines, roughness, 1.0)
        return mirrored_share(self._seen.cosines, roughness, self._options.dielectric) / self._options.dielectric

    def _lobes_of(self, roughness: float) -> list[GgxLobe]:
        """Return the lobes of a roughness at the cosines TILTS; the lobes of the last roughness are cached.

        Across the plane of the tilt, a lobe narrows with the cosine. A round lobe of the same area replaces it.
        """
        if roughness not in self._lobes:
            widths = [roughness * cosine**0.25 for cosine in TILTS]
            self._lobes = {roughness: [GgxLobe(each, self._options.height) for each in widths]}
        return self._lobes[roughness]


def _hats(cosines: np.ndarray) -> list[np.ndarray]:
    """Return, for each of TILTS, its weights [Q] in the linear interpolation at cosines [Q]."""
    return [np.interp(cosines, TILTS, row) for row in np.eye(len(TILTS))]


def mirrored_share(cosines: np.ndarray, roughness: float, reflectance: float) -> np.ndarray:
    """Return the share [...] of a uniform light that a rough surface mirrors at cosines [...] of the tilt.

    reflectance: at normal incidence. The share is the integral of GGX with Schlick's and Smith's terms over
    microfacets, which are drawn by area (Karis, 2013).
    """
    tilts, steps = np.linspace(LEAST_TILT, 1, TABLE)[:, None], (np.arange(DRAWS) + 0.5) / DRAWS
    chance, turn = (each.ravel() for each in np.meshgrid(steps, np.pi * steps))
    square = roughness**4
    up = np.sqrt((1 - chance) / (1 + (square - 1) * chance))
    met = np.sqrt(1 - tilts**2) * np.sqrt(1 - up**2) * np.cos(turn) + tilts * up
    leaving = 2 * met * up - tilts
    masking, shadowing = (
        2 / (1 + np.sqrt(1 + square * (1 / np.maximum(each, 1e-6) ** 2 - 1))) for each in (tilts, leaving)
    )
    fresnel = reflectance + (1 - reflectance) * (1 - np.clip(met, 0, 1)) ** 5
    share = np.where((met > 0) & (leaving > 0), fresnel * masking * shadowing * met / (tilts * up), 0).mean(axis=1)
    return np.asarray(np.interp(cosines, tilts[:, 0], share))


class GgxLobe:
    """The lobe of a rough mirror seen head-on, which blurs maps of height x 2 height cells.

    The lobe is GGX with width roughness^2, times the cosine (Karis, 2013). It depends only on the difference of
    azimuths. A blur is therefore a matrix product for each frequency of the azimuth.
    """

    def __init__(self, roughness: float, height: int) -> None:
        polar, azimuth = (np.arange(height) + 0.5) / height * np.pi, np.arange(2 * height) / height * np.pi
        up, flat = np.cos(polar), np.sin(polar)
        cosines = np.outer(flat, flat)[..., None] * np.cos(azimuth) + np.outer(up, up)[..., None]
        square = roughness**4
        half = (1 + cosines) / 2  # the squared cosine between mirror direction and half vector
        lobe = np.maximum(cosines, 0) * square / (half * (square - 1) + 1) ** 2 * flat[:, None]
        lobe /= lobe.sum(axis=(1, 2), keepdims=True)
        # The lobe is even in the azimuth, so its spectrum is real.
        self._height, self._spectrum = height, np.fft.rfft(lobe, axis=2).real.transpose(2, 0, 1).copy()

    def blur(self, light: np.ndarray) -> np.ndarray:
        """Blur a map `light` [2*height^2,...]: average it at each cell, weighted by the lobe around that cell."""
        return self._filtered(light, self._spectrum)

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Apply the transpose of `blur` to values [2*height^2,...]."""
        return self._filtered(values, self._spectrum.transpose(0, 2, 1))

    def _filtered(self, cells: np.ndarray, spectrum: np.ndarray) -> np.ndarray:
        waves = np.fft.rfft(cells.reshape(self._height, 2 * self._height, -1), axis=1).transpose(1, 0, 2)
        products = spectrum @ waves.real + 1j * (spectrum @ waves.imag)
        filtered = np.fft.irfft(products.transpose(1, 0, 2), 2 * self._height, axis=1)
        return np.asarray(filtered.reshape(cells.shape))
