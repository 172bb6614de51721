"""Photometric stereo under a flash: with the lamp beside the lens, brightness depends on the tilt of the surface.

On a matte surface under a point light, brightness times the squared distance is albedo x cosine of the tilt (Lambert),
in linear light. Several views of a point determine three unknowns, its normal times its albedo, by least squares
(photometric stereo, Woodham 1980). Highlights are brighter than the model, and reweighting removes them. Where the mesh
is off the surface, each view shows a different place, and the larger residual lowers the confidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import FlashOptions
from mgsr.data.camera import Camera
from mgsr.parallel import map_ahead
from mgsr.shading.ambient_occlusion import AmbientOcclusion
from mgsr.shading.lighting import lamp_light
from mgsr.shading.observations import Observations
from mgsr.shading.target_normals import TargetNormals

CHUNK = 4096  # points at a time


@dataclass(frozen=True)
class Flash:
    """A lamp that moves with the camera, and the other light on a surface.

    right, down: the lamp's offset from the lens, along the camera's x and y axes, in the scene's unit.
    ambient: the ambient light, relative to the lamp's light at a distance of 1.
    bounced: the factor of the interreflected light, on the same scale.
    """

    right: float = 0.0
    down: float = 0.0
    ambient: float = 0.0
    bounced: float = 0.0

    def lamps(self, cameras: Sequence[Camera]) -> np.ndarray:
        """Return the lamp's position [N,3] for each camera's photograph, in the scene's frame."""
        sides = np.stack([camera.cam_from_world[:2, :3] for camera in cameras])
        centers = np.stack([camera.center for camera in cameras])
        positions: np.ndarray = centers + np.array([self.right, self.down]) @ sides
        return positions


def flash_ratio(observations: Observations, normals: np.ndarray, options: FlashOptions = FlashOptions()) -> float:
    """Return the share of the brightness's deviation that a flash at the lens leaves unexplained.

    normals [P,3]: the observed points' unit normals. A point's share is its deviation from the flash's shading over its
    deviation from a constant brightness. The result is the median over the points, or infinite if too few photographs
    see each of them.
    """
    brightness, weights = observations.brightness * observations.distances**2, observations.weights**2
    cosines = np.maximum(np.einsum("pki,pi->pk", observations.view_directions, normals), 0)
    shaded = deviation(brightness - cosines * least_squares_scale(brightness, cosines, weights)[:, None], weights)
    plain = deviation(brightness - least_squares_scale(brightness, np.ones_like(cosines), weights)[:, None], weights)
    enough = observations.counts >= options.min_observations
    return float(np.median(shaded[enough] / np.maximum(plain[enough], 1e-9))) if enough.any() else np.inf


def normals_from_flash(
    observations: Observations,
    points: np.ndarray,
    normals: np.ndarray,
    flash: Flash,
    cameras: Sequence[Camera],
    occlusion: AmbientOcclusion,
    threads: int | None = None,
    options: FlashOptions = FlashOptions(),
) -> TargetNormals:
    """Estimate the normals of points from a flash's shading, by photometric stereo.

    points [P,3]: the observed points, in the scene's frame. normals [P,3]: their unit normals on the mesh. cameras:
    those of the photographs. occlusion: ambient occlusion and interreflection of the surface.
    """
    lamps = flash.lamps(cameras)
    sky_visibility, interreflection = occlusion.at(points, observations.photographs)

    def explain(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the normals [R,3] of the points `part` [R], and their standard deviations [R] in radians."""
        some = observations.at(part)
        to_lamps = (lamps[some.photographs] - points[part, None]).astype(np.float32)
        distances = np.linalg.norm(to_lamps, axis=-1)
        ambient = (flash.ambient * sky_visibility[part, None] + flash.bounced * interreflection[part]) * distances**2
        brightness, weights = some.brightness * distances**2, some.weights**2
        return _solve(to_lamps / distances[..., None], brightness, ambient, weights, normals[part], options)

    parts = np.array_split(np.arange(len(points)), -(-len(points) // CHUNK))
    solved, known = (np.concatenate(column) for column in zip(*map_ahead(explain, parts, threads), strict=True))
    enough = observations.counts >= options.min_observations
    return TargetNormals(solved, np.where(enough, 1 / (1 + (known / options.half_confidence) ** 2), 0))


def fit_albedo(
    observations: Observations,
    points: np.ndarray,
    normals: np.ndarray,
    flash: Flash,
    cameras: Sequence[Camera],
    occlusion: AmbientOcclusion,
    options: FlashOptions = FlashOptions(),
) -> np.ndarray:
    """Estimate the albedo [P] of points [P,3] with unit normals [P,3], without highlights.

    The albedo is the brightness under an irradiance of 1; it is 0 where no photograph shows the point.
    """
    sky_visibility, interreflection = occlusion.at(points, observations.photographs)
    lamp = lamp_light(flash.lamps(cameras)[observations.photographs] - points[:, None], normals[:, None])
    light = lamp + flash.ambient * sky_visibility[:, None] + flash.bounced * interreflection
    brightness = observations.brightness.astype(float)
    weights = current = observations.weights**2
    for _ in range(options.rounds):
        albedo = least_squares_scale(brightness, light, current)
        current = irls_weights(brightness - albedo[:, None] * light, weights, current, options)
    clipped: np.ndarray = np.maximum(albedo, 0)
    return clipped


def _solve(
    lamp_directions: np.ndarray,
    brightness: np.ndarray,
    ambient: np.ndarray,
    weights: np.ndarray,
    normals: np.ndarray,
    options: FlashOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for unit normals [P,3] and their standard deviations [P], in radians, by robust least squares.

    The model is brightness = albedo * (cosine of the tilt + ambient). lamp_directions [P,K,3]: unit directions to the
    lamp. brightness, ambient [P,K]: without the lamp's falloff. weights [P,K]. normals [P,3]: the mesh's unit normals.
    """
    current, solved = weights, normals
    products = np.stack([lamp_directions[..., i] * lamp_directions[..., j] for i, j in _PAIRS], axis=1)
    for _ in range(options.rounds):
        own = options.prior_weight * current.sum(axis=1)
        cosines = np.maximum(np.einsum("pki,pi->pk", lamp_directions, solved), 0)
        albedo = least_squares_scale(brightness, cosines + ambient, current)
        direct = brightness - albedo[:, None] * ambient
        matrix = (products @ current[..., None])[:, _PLACES, 0] + (own + 1e-9)[:, None, None] * np.eye(3)
        right = np.einsum("pki,pk->pi", lamp_directions, direct * current) + (own * albedo)[:, None] * normals
        tilted = np.linalg.solve(matrix, right[..., None])[..., 0]
        residual = direct - np.einsum("pki,pi->pk", lamp_directions, tilted)
        current = irls_weights(residual, weights, current, options)
        solved = tilted / np.maximum(np.linalg.norm(tilted, axis=1, keepdims=True), 1e-9)
    spread = np.trace(np.linalg.inv(matrix), axis1=1, axis2=2)
    return solved, deviation(residual, current) / np.maximum(albedo, 1e-9) * np.sqrt(spread)


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix's entries
_PLACES = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # the index of each entry in _PAIRS


def least_squares_scale(brightness: np.ndarray, shape: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the factor [P] by which shape [P,K] fits brightness [P,K] best, in least squares with weights [P,K]."""
    albedo: np.ndarray = (brightness * shape * weights).sum(1) / np.maximum((shape * shape * weights).sum(1), 1e-9)
    return albedo


def deviation(residual: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted root mean square [P] of residual [P,K]; weights [P,K]."""
    deviations: np.ndarray = np.sqrt((weights * residual * residual).sum(1) / np.maximum(weights.sum(1), 1e-9))
    return deviations


def irls_weights(residual: np.ndarray, weights: np.ndarray, current: np.ndarray, options: FlashOptions) -> np.ndarray:
    """Return robust weights [P,K], which are lower for larger residuals.

    Bright outliers, such as highlights, lose more weight than dark ones. residual [P,K]: in linear light. weights
    [P,K]: the weights without regard to the residuals. current [P,K]: the weights of the previous round, which give the
    residuals' deviation.
    """
    spread = deviation(residual, current)[:, None] + 1e-6
    high, low = np.maximum(residual, 0) / (options.above * spread), np.minimum(residual, 0) / (options.below * spread)
    reduced: np.ndarray = weights / ((1 + high**2) * (1 + low**2))
    return reduced
