"""Calibration of a flash: four parameters for a whole capture, its offset from the lens and the other light.

An unmodelled offset of a few centimetres tilts all estimated normals. Unmodelled ambient light and interreflection
flatten them. The observations of all points together determine the parameters, by Gauss-Newton with the points' albedos
eliminated (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import FlashOptions
from mgsr.data.camera import Camera
from mgsr.shading.ambient_occlusion import AmbientOcclusion
from mgsr.shading.flash import Flash, deviation, irls_weights, least_squares_scale
from mgsr.shading.observations import Observations


def fit_flash(
    observations: Observations,
    points: np.ndarray,
    normals: np.ndarray,
    cameras: Sequence[Camera],
    occlusion: AmbientOcclusion,
    start: Flash,
    options: FlashOptions = FlashOptions(),
) -> Flash:
    """Fit the flash that explains the observations of a surface's points [P,3] with unit normals [P,3].

    cameras: those of the photographs. start: the initial guess, which is returned if too few photographs see the
    points.
    """
    fit, seen = options.fit, np.flatnonzero(observations.counts >= options.min_observations)
    seen = seen[:: max(1, len(seen) // fit.points)]
    if len(seen) == 0:
        return start
    observations = observations.at(seen)
    equations = _equations(observations, points[seen], normals[seen], cameras, occlusion)
    brightness, weights = observations.brightness.astype(float), observations.weights.astype(float) ** 2
    values = np.array([start.right, start.down, start.ambient, start.bounced])
    distance = float(np.median(observations.distances))
    for _ in range(fit.steps):
        before, values = values, values + _step(*equations.shade(values), brightness, weights, options)
        values[:2] *= min(1, fit.max_offset * distance / max(float(np.linalg.norm(values[:2])), 1e-9))
        values[2:] = np.maximum(values[2:], 0)
        if np.abs(values - before)[:2].max() < fit.step_tolerance * distance:
            break
    return Flash(*values.tolist())


@dataclass(frozen=True)
class _FlashEquations:
    """The shading equations of P points in K photographs each.

    to_lens [P,K,3]: the vector to the lens, in the scene's frame and unit.
    sides [P,K,2,3]: the camera's x and y axes.
    cosines [P,K], tilts [P,K,2]: the components of to_lens and of sides along the normal.
    ambient [P,K,2]: the sky visibility and the interreflected light.
    """

    to_lens: np.ndarray
    sides: np.ndarray
    cosines: np.ndarray
    tilts: np.ndarray
    ambient: np.ndarray

    def shade(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the brightness [P,K] at an albedo of 1, and its derivatives [P,K,4], for a `Flash`'s values [4]."""
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
) -> _FlashEquations:
    """Return the shading equations of points [P,3] with unit normals [P,3], in the scene's frame."""
    to_lens = observations.view_directions.astype(float) * observations.distances[..., None]
    sides = np.stack([camera.cam_from_world[:2, :3] for camera in cameras])[observations.photographs]
    sky_visibility, interreflection = occlusion.at(points, observations.photographs)
    ambient = np.stack([np.broadcast_to(sky_visibility[:, None], interreflection.shape), interreflection], axis=-1)
    cosines, tilts = np.einsum("pki,pi->pk", to_lens, normals), np.einsum("pksi,pi->pks", sides, normals)
    return _FlashEquations(to_lens, sides, cosines, tilts, ambient)


def _step(
    shade: np.ndarray, slopes: np.ndarray, brightness: np.ndarray, weights: np.ndarray, options: FlashOptions
) -> np.ndarray:
    """Return the Gauss-Newton step [4] for fitting albedo times shade [P,K] to brightness [P,K].

    slopes [P,K,4]: the derivatives of the shade. weights [P,K]. Each point's albedo is eliminated.
    """
    current = weights
    for _ in range(options.fit.rounds):
        albedo = least_squares_scale(brightness, shade, current)
        residual = brightness - albedo[:, None] * shade
        current = irls_weights(residual, weights, current, options)
    # Variable projection: remove the part of the slopes that a change of albedo explains.
    total = np.maximum((current * shade**2).sum(axis=1), 1e-12)
    along = np.einsum("pk,pkv->pv", current * shade, slopes) / total[:, None]
    slopes = albedo[:, None, None] * (slopes - shade[..., None] * along[:, None])
    current = current / (deviation(residual, current)[:, None] ** 2 + 1e-12)
    matrix = np.einsum("pk,pku,pkv->uv", current, slopes, slopes)
    matrix += np.diag(options.fit.damping * matrix.diagonal() + 1e-9)
    return np.linalg.solve(matrix, np.einsum("pk,pkv->v", current * residual, slopes))
