"""Shading of a surface under static light, separated from its colours.

Brightness changes with the direction of a surface and with what hides the sky, albedo changes at few places. So the
light is chosen that explains most of the change between neighbouring places, and steps of the albedo count as outliers
(Retinex; Land and McCann, 1971). The light is low in frequency, as matte surfaces show no more of it (Ramamoorthi and
Hanrahan, 2001), and its mean is white and 1.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import Hemispheres

REACH = 2.0  # edges over which the rays of neighbours are averaged
PLACES = 3000  # of the surface, between which brightness is compared
NEIGHBOURS = 8  # of each place
STEP = 0.05  # change of the log albedo that begins to count as a step
PRIOR = 0.004  # change of the log brightness that a light of 1 must explain between neighbours to be worth it
LEAST_GAIN = 0.03  # share of the cost by which a light must explain the changes better than even light,
LEAST_CHANGE = 0.01  # and the change of the log brightness, root mean square, that it must explain
DARKEST = 0.1  # least irradiance, so that dark places keep their noise


def static_irradiance(mesh: Mesh, colors: np.ndarray, seen: Hemispheres, seed: int = 0) -> np.ndarray:
    """Return the irradiance [V,3] of a mesh's vertices, relative to the mean light.

    colors [V,3]: the light that the vertices send out, linear. They also light each other. Where no light explains the
    colours better, the light is even, and only the hidden parts of the sky count.
    """
    colors = np.maximum(colors.astype(np.float64), 1e-3)
    # The rays' noise would be explained by a sky as bright as the surface.
    sky, bounced = (diffuse(each, mesh.laplacian, REACH) for each in (seen.sky, seen.surface @ colors))
    first, second = _pairs(mesh, seed)
    irradiance = np.empty_like(colors)
    for channel in range(3):
        light = _fit_light(sky, bounced[:, channel], np.log(colors[:, channel]), first, second)
        irradiance[:, channel] = sky @ light + bounced[:, channel]
    return np.asarray(np.maximum(irradiance, DARKEST))


def _pairs(mesh: Mesh, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of neighbouring vertices [Q] among PLACES of them, drawn by area."""
    areas = np.linalg.norm(mesh.face_crosses, axis=1)
    weights = np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices))
    count = min(PLACES, int(np.count_nonzero(weights)))
    places = np.random.default_rng(seed).choice(len(weights), count, replace=False, p=weights / weights.sum())
    _, near = cKDTree(mesh.vertices[places]).query(mesh.vertices[places], k=min(NEIGHBOURS + 1, count))
    near = near.reshape(count, -1)[:, 1:]
    return np.repeat(places, near.shape[1]), places[near.ravel()]


def _fit_light(
    sky: np.ndarray, bounced: np.ndarray, logs: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Return the light [9] that explains the changes of the log brightness [V] between pairs of vertices [Q].

    sky [V,9] and bounced [V]: as in `static_irradiance`, of one channel.
    """
    change, even = logs[first] - logs[second], sky[:, 0] + bounced
    hold = PRIOR * len(change) ** 0.5

    def arriving(light: np.ndarray) -> np.ndarray:
        return np.asarray(np.maximum(even + sky[:, 1:] @ light, DARKEST))

    def residual(light: np.ndarray) -> np.ndarray:
        shading = np.log(arriving(light))
        return np.concatenate([_robust(change - shading[first] + shading[second]), hold * light])

    def cost(light: np.ndarray) -> float:
        return float((residual(light)[: len(change)] ** 2).sum())

    fitted = least_squares(residual, np.zeros(8), method="trf", max_nfev=15).x
    none = np.zeros(8)
    least = max(LEAST_GAIN * cost(none), len(change) * LEAST_CHANGE**2)
    return np.concatenate([[1.0], fitted if cost(none) - cost(fitted) > least else none])


def _robust(residuals: np.ndarray) -> np.ndarray:
    """Return residuals whose squares grow like their absolute values beyond STEP."""
    scaled = residuals / STEP
    return np.asarray(STEP * np.sign(residuals) * np.sqrt(2 * (np.sqrt(1 + scaled * scaled) - 1)))
