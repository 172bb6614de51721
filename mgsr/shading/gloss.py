"""The gloss of a surface: how rough it is, whether it is a metal, and the environment that it mirrors.

The photographs of a glossy surface are explained by one environment map, blurred by the surface's roughness (GGX;
Walter et al., 2007), reflected by Fresnel's law, and a matte part that looks the same from all sides. A metal has no
matte part. A map can hold blurred light as well as sharp light, but no light is negative: so the photographs tell the
roughness where the environment has lamps or edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import minimize

from mgsr.config.expert import GlossOptions
from mgsr.data.images import srgb_to_linear
from mgsr.data.photograph import Photograph
from mgsr.data.scene import View, some_of
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_fit import sample_map, steps_squared
from mgsr.shading.material import MATTE, Material
from mgsr.shading.observations import observe_photographs, read_image

ROUGHNESSES = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8)


@dataclass(frozen=True)
class Mirrorings:
    """Q observations of P points: what each photograph shows of a point.

    owners [Q]: the point. directions [Q,3]: unit, where it mirrors the line of sight to. cosines [Q]: of the tilt.
    colors [Q,3]: linear light. weights [Q]. training [Q] bool: not held out.
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
    """Collect what photographs show of a mesh's vertices, without those whose mirrored ray meets the mesh again.

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
    directions = 2 * cosines[:, None] * normals - eye
    places = mesh.vertices[points][owners]
    free = ~mesh.caster.cast_rays(places + gap * normals, directions).mask
    numbers = observed.photographs[owners, seen]
    colors = np.zeros((len(owners), 3), np.float32)
    for number, view in enumerate(some_of(views)):
        own = np.flatnonzero(numbers == number)
        pixels, _ = view.camera.project(places[own])
        linear = srgb_to_linear(view.image.astype(np.float32) / 255)
        colors[own] = np.stack([read_image(linear[..., channel], pixels) for channel in range(3)], axis=1)
    weights = observed.weights[owners, seen]
    held = numbers % options.held_out == options.held_out - 1
    return Mirrorings(*(each[free] for each in (owners, directions, cosines, colors, weights, ~held)))


def fit_gloss(seen: Mirrorings, options: GlossOptions = GlossOptions()) -> Material:
    """Fit the material of a glossy surface to its observations; MATTE where gloss does not explain them better."""
    gray = seen.colors.mean(axis=1)
    if not (gray[seen.training].any() and gray[~seen.training].any()):
        return MATTE
    height, rows = options.height, sample_map(seen.directions, options.height).astype(np.float32)
    dark = np.zeros(2 * height**2)
    coat, metal = (_Fit(seen, rows, metallic, options) for metallic in (False, True))
    lights = [fit.solve(gray, ROUGHNESSES[0], dark, options.first_steps) for fit in (coat, metal)]
    errors = [fit.deviation(gray, ROUGHNESSES[0], light) for fit, light in zip((coat, metal), lights, strict=True)]
    if min(errors) > options.matte_deviation * coat.deviation(gray, ROUGHNESSES[0], dark):
        return MATTE
    metallic = errors[1] < options.metal_deviation * errors[0]
    fit = metal if metallic else coat
    found = _try_roughnesses(fit, gray, lights[metallic], options)
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
    """The equations of one model: a dielectric over a matte part, or a metal without one."""

    def __init__(self, seen: Mirrorings, rows: sparse.csr_matrix, metallic: bool, options: GlossOptions) -> None:
        """Prepare the fit; rows [Q,2*height^2] sample a map where the points mirror to."""
        self._seen, self._metallic, self._options = seen, metallic, options
        self._rows, self._turned = rows, rows.T.tocsr()
        self._smooth = steps_squared(options.height)
        self._lobes: dict[float, np.ndarray] = {}

    def solve(self, values: np.ndarray, roughness: float, start: np.ndarray, steps: int) -> np.ndarray:
        """Return the light [2*height^2], nowhere negative, that best explains values [Q] of the training photographs.

        It is multiplied by the reflectance at normal incidence. start [2*height^2]: the first guess. steps: of the
        optimiser, at most.
        """
        lobe, share = self._lobe(roughness), self._share(roughness)
        weights = self._seen.weights * self._seen.training
        hold = self._options.smoothness * weights.sum() / len(start)
        scale = float((weights * values * values).sum()) / len(start)

        def cost(light: np.ndarray) -> tuple[float, np.ndarray]:
            residual = self._centred(values - share * (self._rows @ (lobe @ light.astype(np.float32))), weights)
            pull = self._smooth @ light
            slope = -(lobe.T @ (self._turned @ (share * weights * residual).astype(np.float32)))
            value = 0.5 * float((weights * residual * residual).sum() + hold * (light @ pull))
            return value / scale, (slope + hold * pull) / scale

        bounds = [(0, None)] * len(start)
        options = {"maxiter": steps, "ftol": self._options.tolerance}
        fitted: np.ndarray = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
        return fitted

    def deviation(self, values: np.ndarray, roughness: float, light: np.ndarray) -> float:
        """Return the root mean square of what a light leaves of values [Q] in the held-out photographs.

        The matte part of each point is that of the training photographs. Residuals above `outlier` count no more than
        it, as for what the model does not know, such as second reflections.
        """
        seen = self._seen
        residual = values - self._share(roughness) * (self._rows @ (self._lobe(roughness) @ light.astype(np.float32)))
        judged = seen.weights * ~seen.training
        if not self._metallic:
            training = seen.weights * seen.training
            sums, total = (np.bincount(seen.owners, each) for each in (training * residual, training))
            residual = residual - (sums / np.maximum(total, 1e-9))[seen.owners]
            judged = judged * (total[seen.owners] > 0)
        clipped = np.minimum(residual**2, self._options.outlier**2)
        return float(np.sqrt((judged * clipped).sum() / max(judged.sum(), 1e-9)))

    def spread(self, lights: np.ndarray, roughness: float) -> np.ndarray:
        """Return the light [Q,3] of a map [2*height^2,3] that the points mirror."""
        return np.asarray(self._rows @ (self._lobe(roughness) @ lights.astype(np.float32)))

    def _centred(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return values [Q] less each point's mean by weights [Q], which its matte part explains; a metal has none."""
        if self._metallic:
            return values
        owners = self._seen.owners
        mean = np.bincount(owners, weights * values) / np.maximum(np.bincount(owners, weights), 1e-9)
        return np.asarray(values - mean[owners])

    def _share(self, roughness: float) -> np.ndarray:
        """Return the mirrored share [Q] of each observation, relative to the reflectance at normal incidence."""
        if self._metallic:
            return mirrored_share(self._seen.cosines, roughness, 1.0)
        return mirrored_share(self._seen.cosines, roughness, self._options.dielectric) / self._options.dielectric

    def _lobe(self, roughness: float) -> np.ndarray:
        """Return `ggx_lobes`, of which the last is kept."""
        if roughness not in self._lobes:
            self._lobes = {roughness: ggx_lobes(roughness, self._options.height)}
        return self._lobes[roughness]


def mirrored_share(cosines: np.ndarray, roughness: float, reflectance: float) -> np.ndarray:
    """Return the share [...] of a uniform light that a rough surface mirrors at cosines [...] of the tilt.

    reflectance: at normal incidence. Source: Karis, 2014 (Physically based shading on mobile), a fit to the integral of
    GGX with Schlick's Fresnel term.
    """
    x, y, z, w = (
        a * roughness + b for a, b in zip((-1, -0.0275, -0.572, 0.022), (1, 0.0425, 1.04, -0.04), strict=True)
    )
    grazing = np.minimum(x * x, 2 ** (-9.28 * np.clip(cosines, 0, 1))) * x + y
    return np.asarray(reflectance * (-1.04 * grazing + z) + 1.04 * grazing + w)


def ggx_lobes(roughness: float, height: int = GlossOptions().height) -> np.ndarray:
    """Return the matrix [N,N] float32, N = 2*height^2, that blurs a map by the lobe of a rough mirror seen head-on.

    Rows sum to 1. The lobe is GGX with width roughness^2, times the cosine (Karis, 2013).
    """
    polar = (np.arange(height) + 0.5) / height * np.pi
    azimuth = (np.arange(2 * height) + 0.5) / height * np.pi
    flat, up = np.sin(polar)[:, None], np.cos(polar)[:, None] + 0 * azimuth
    cells = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1).reshape(-1, 3).astype(np.float32)
    cosines = np.clip(cells @ cells.T, -1, 1)
    square = roughness**4
    half = (1 + cosines) / 2  # the squared cosine between mirror direction and half vector
    lobe = np.maximum(cosines, 0) * square / (half * (square - 1) + 1) ** 2 * np.repeat(flat[:, 0], 2 * height)
    blurred: np.ndarray = (lobe / lobe.sum(axis=1, keepdims=True)).astype(np.float32)
    return blurred
