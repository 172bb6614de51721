"""Calibration of a flash: its place beside the lens and the other light, four numbers for a whole capture.

A lamp a hand's breadth off the lens tilts all normals that are read from it; a little light from everywhere, and
interreflection in hollows, flatten them. All points' observations together tell these apart (Gauss-Newton, each point's
albedo being solved for on the way: variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera
from mgsr.shading.ambient_occlusion import AmbientOcclusion
from mgsr.shading.flash import Flash, deviation, irls_weights, least_squares_scale
from mgsr.shading.observations import Observations
from mgsr.shading.target_normals import MIN_OBSERVATIONS

POINTS = 3000  # whose observations tell of the light
STEPS = 40  # at most
STEP_TOLERANCE = 3e-4  # of the distance to the surface; a step of the lamp by less is the last
ROUNDS = 4  # of new weights in a step
DAMPING = 1e-3  # of a step, where the capture hardly tells of a number (Levenberg and Marquardt)
MAX_OFFSET = 0.25  # of the distance to the surface; how far off the lens a lamp may be


def fit_flash(
    observations: Observations,
    points: np.ndarray,
    normals: np.ndarray,
    cameras: Sequence[Camera],
    occlusion: AmbientOcclusion,
    start: Flash,
) -> Flash:
    """Fit the flash that explains the observations of a surface's points [P,3] with normals [P,3].

    cameras: those of the photographs; start: where the search begins, returned where too few photographs see the
    points.
    """
    seen = np.flatnonzero(observations.counts >= MIN_OBSERVATIONS)
    seen = seen[:: max(1, len(seen) // POINTS)]
    if len(seen) == 0:
        return start
    observations = observations.at(seen)
    equations = _equations(observations, points[seen], normals[seen], cameras, occlusion)
    brightness, weights = observations.brightness.astype(float), observations.weights.astype(float) ** 2
    values = np.array([start.right, start.down, start.ambient, start.bounced])
    distance = float(np.median(observations.distances))
    for _ in range(STEPS):
        before, values = values, values + _step(*equations.shade(values), brightness, weights)
        values[:2] *= min(1, MAX_OFFSET * distance / max(float(np.linalg.norm(values[:2])), 1e-9))
        values[2:] = np.maximum(values[2:], 0)
        if np.abs(values - before)[:2].max() < STEP_TOLERANCE * distance:
            break
    return Flash(*values.tolist())


@dataclass(frozen=True)
class _Equations:
    """The shading equations of P points in K photographs each.

    to_lens [P,K,3]: the way to the lens; sides [P,K,2,3]: the camera's axes to the right and down; cosines [P,K] and
    tilts [P,K,2]: the components of both along the normal; ambient [P,K,2]: the open share of the sky, and the
    interreflected light.
    """

    to_lens: np.ndarray
    sides: np.ndarray
    cosines: np.ndarray
    tilts: np.ndarray
    ambient: np.ndarray

    def shade(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the brightness [P,K] of an albedo of 1 at the values [4] of a `Flash`, and its derivatives [P,K,4]."""
        to_lamp = self.to_lens + np.einsum("s,pksi->pki", values[:2], self.sides)
        square = (to_lamp**2).sum(axis=-1)
        lamp = np.maximum(self.cosines + self.tilts @ values[:2], 0) / square**1.5
        aside = np.einsum("pki,pksi->pks", to_lamp, self.sides)
        moved = (lamp > 0)[..., None] * self.tilts / square[..., None] ** 1.5 - 3 * (lamp / square)[..., None] * aside
        return lamp + self.ambient @ values[2:], np.concatenate([moved, self.ambient], axis=-1)


def _equations(
    observations: Observations,
    points: np.ndarray,
    normals: np.ndarray,
    cameras: Sequence[Camera],
    occlusion: AmbientOcclusion,
) -> _Equations:
    to_lens = observations.view_directions.astype(float) * observations.distances[..., None]
    sides = np.stack([camera.cam_from_world[:2, :3] for camera in cameras])[observations.photographs]
    sky_visibility, interreflection = occlusion.at(points, observations.photographs)
    ambient = np.stack([np.broadcast_to(sky_visibility[:, None], interreflection.shape), interreflection], axis=-1)
    cosines, tilts = np.einsum("pki,pi->pk", to_lens, normals), np.einsum("pksi,pi->pks", sides, normals)
    return _Equations(to_lens, sides, cosines, tilts, ambient)


def _step(shade: np.ndarray, slopes: np.ndarray, brightness: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the Gauss-Newton step [4] that lets the shade [P,K], times each point's albedo, fit the brightness [P,K].

    slopes [P,K,4]: the derivatives of the shade; weights [P,K].
    """
    current = weights
    for _ in range(ROUNDS):
        albedo = least_squares_scale(brightness, shade, current)
        residual = brightness - albedo[:, None] * shade
        current = irls_weights(residual, weights, current)
    # What a change of albedo would do as well is no reason for a change of the light.
    total = np.maximum((current * shade**2).sum(axis=1), 1e-12)
    along = np.einsum("pk,pkv->pv", current * shade, slopes) / total[:, None]
    slopes = albedo[:, None, None] * (slopes - shade[..., None] * along[:, None])
    current = current / (deviation(residual, current)[:, None] ** 2 + 1e-12)
    matrix = np.einsum("pk,pku,pkv->uv", current, slopes, slopes)
    matrix += np.diag(DAMPING * matrix.diagonal() + 1e-9)
    return np.linalg.solve(matrix, np.einsum("pk,pkv->v", current * residual, slopes))
