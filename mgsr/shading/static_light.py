"""Shading of a surface under static light, separated from its colours.

Brightness changes with the direction of a surface and with its view of the sky. Albedo changes at few places. The fit
chooses the light that explains most of the change between neighbouring places; steps of the albedo count as outliers
(Retinex; Land and McCann, 1971). The light has low frequencies only, because matte surfaces reveal no others
(Ramamoorthi and Hanrahan, 2001). Its mean is white and 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.spatial import cKDTree

from mgsr.config.expert import StaticLightOptions
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import Hemispheres, real_harmonics
from mgsr.shading.environment_fit import cell_directions


@dataclass(frozen=True)
class StaticLight:
    """Static light on the vertices of a mesh, relative to its mean.

    irradiance [V,3]: over pi, interreflections included. harmonics [9,3]: the sky's radiance, as coefficients of
    `real_harmonics`; the first are 1.
    """

    irradiance: np.ndarray
    harmonics: np.ndarray

    def environment(self, height: int, freedom: float = StaticLightOptions().freedom) -> np.ndarray:
        """Return a non-negative sky [height,2*height,3] that gives matte surfaces the same irradiance.

        Harmonics of a low degree are negative in places, and matte surfaces do not reveal the higher degrees. The
        result is the nearest nonnegative sky with these harmonics. freedom: cost of a change of the radiance, relative
        to the same change of a harmonic.
        """
        directions = cell_directions(height).reshape(-1, 3)
        areas = np.sqrt(1 - directions[:, 2] ** 2)
        shares = areas / areas.sum()
        basis = real_harmonics(directions)
        radiance = basis @ self.harmonics
        weights = freedom * np.sqrt(shares)
        equations = np.concatenate([basis.T * shares, np.diag(weights)])
        values = np.concatenate([self.harmonics, weights[:, None] * radiance])
        sky = np.stack([nnls(equations, each)[0] for each in values.T], axis=1)
        return sky.reshape(height, 2 * height, 3).astype(np.float32)


def fit_static_light(
    mesh: Mesh,
    colors: np.ndarray,
    seen: Hemispheres,
    seed: int = 0,
    options: StaticLightOptions = StaticLightOptions(),
) -> StaticLight:
    """Fit the static light on a mesh's vertices.

    colors [V,3]: linear radiance of the vertices, which also light each other. If no light explains the colours better,
    the sky is uniform, and only occlusion counts.
    """
    colors = np.maximum(colors.astype(np.float64), 1e-3)
    # Smooth both: the fit would explain the noise of the rays by a sky as bright as the surface.
    sky, bounced = (diffuse(each, mesh.laplacian, options.reach) for each in (seen.sky, seen.surface @ colors))
    first, second = _pairs(mesh, seed, options)
    logs = np.log(colors)
    lights = [_fit_light(sky, bounced[:, each], logs[:, each], first, second, options) for each in range(3)]
    harmonics = np.stack(lights, axis=1)
    return StaticLight(np.maximum(sky @ harmonics + bounced, options.darkest), harmonics)


def _pairs(mesh: Mesh, seed: int, options: StaticLightOptions) -> tuple[np.ndarray, np.ndarray]:
    """Draw vertices in proportion to area, and return the pairs of neighbours among them: two arrays [Q]."""
    areas = np.linalg.norm(mesh.face_crosses, axis=1)
    weights = np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices))
    count = min(options.places, int(np.count_nonzero(weights)))
    places = np.random.default_rng(seed).choice(len(weights), count, replace=False, p=weights / weights.sum())
    _, near = cKDTree(mesh.vertices[places]).query(mesh.vertices[places], k=min(options.neighbours + 1, count))
    near = near.reshape(count, -1)[:, 1:]
    return np.repeat(places, near.shape[1]), places[near.ravel()]


def _fit_light(
    sky: np.ndarray,
    bounced: np.ndarray,
    logs: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    options: StaticLightOptions,
) -> np.ndarray:
    """Fit one channel's light [9] to the changes of log brightness between pairs of vertices.

    sky [V,9] and bounced [V]: as in `fit_static_light`, of one channel.
    """
    change, constant = logs[first] - logs[second], sky[:, 0] + bounced
    prior_weight = options.prior * len(change) ** 0.5

    def arriving(light: np.ndarray) -> np.ndarray:
        return np.asarray(np.maximum(constant + sky[:, 1:] @ light, options.darkest))

    def residual(light: np.ndarray) -> np.ndarray:
        shading = np.log(arriving(light))
        return np.concatenate([_robust(change - shading[first] + shading[second], options.step), prior_weight * light])

    def cost(light: np.ndarray) -> float:
        return float((residual(light)[: len(change)] ** 2).sum())

    fitted = least_squares(residual, np.zeros(8), method="trf", max_nfev=options.evaluations).x
    none = np.zeros(8)
    least = max(options.min_gain * cost(none), len(change) * options.min_change**2)
    return np.concatenate([[1.0], fitted if cost(none) - cost(fitted) > least else none])


def _robust(residuals: np.ndarray, step: float) -> np.ndarray:
    """Scale residuals [Q] so that the squares of those beyond `step` grow linearly with the residual."""
    scaled = residuals / step
    return np.asarray(step * np.sign(residuals) * np.sqrt(2 * (np.sqrt(1 + scaled * scaled) - 1)))
