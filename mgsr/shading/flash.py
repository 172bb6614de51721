"""Photometric stereo under a flash: how bright a point is, with the lamp beside the lens, tells how it is tilted.

For a matte surface lit from one place, brightness times the squared distance is albedo x cosine of the tilt (Lambert),
in linear light. Several views of a point give three unknowns, its normal times its albedo, by least squares
(photometric stereo, Woodham 1980); highlights are brighter than that and lose their weight in rounds. A mesh that is
off its surface reads another place in each view: the residual then tells that the normal is not to be trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera
from mgsr.parallel import map_ahead
from mgsr.shading.explained import MIN_READINGS, Explained
from mgsr.shading.hollows import Hollows
from mgsr.shading.lighting import lamp_light
from mgsr.shading.readings import Readings

OWN = 0.005  # weight of the surface's own normal beside the photographs'
ROUNDS = 5  # of least squares with new weights
ABOVE, BELOW = 0.5, 1.5  # deviations at which a reading that is too bright, or too dark, counts half
KNOWN = 0.03  # radians; a normal that is known to this is half trusted
CHUNK = 4096  # points at a time


@dataclass(frozen=True)
class Flash:
    """A lamp that moves with the camera, and the other light on a surface.

    right, down: where the lamp is in the camera's frame, from the lens, in the scene's units. ambient: the light from
    everywhere, where the lamp gives 1 at a distance of 1; bounced: how much of the light that arrives from the surface
    itself is sent back, in the same measure.
    """

    right: float = 0.0
    down: float = 0.0
    ambient: float = 0.0
    bounced: float = 0.0

    def lamps(self, cameras: Sequence[Camera]) -> np.ndarray:
        """Return the lamp's positions [N,3] for the cameras' photographs, in the scene's frame."""
        sides = np.stack([camera.cam_from_world[:2, :3] for camera in cameras])
        centers = np.stack([camera.center for camera in cameras])
        positions: np.ndarray = centers + np.array([self.right, self.down]) @ sides
        return positions


def flash_ratio(readings: Readings, normals: np.ndarray) -> float:
    """Return the share of the brightness' deviation that a flash at the lens leaves unexplained.

    normals [P,3]: the surface's at the P points of the readings. It is the median over the points of the deviation from
    shading by the flash, as a share of the deviation from one brightness a point; infinite without points that enough
    photographs see.
    """
    brightness, weights = readings.brightness * readings.distances**2, readings.weights**2
    cosines = np.maximum(np.einsum("pki,pi->pk", readings.towards, normals), 0)
    shaded = deviation(brightness - cosines * scale(brightness, cosines, weights)[:, None], weights)
    plain = deviation(brightness - scale(brightness, np.ones_like(cosines), weights)[:, None], weights)
    sure = readings.counts >= MIN_READINGS
    return float(np.median(shaded[sure] / np.maximum(plain[sure], 1e-9))) if sure.any() else np.inf


def explain_by_flash(
    readings: Readings,
    points: np.ndarray,
    normals: np.ndarray,
    flash: Flash,
    cameras: Sequence[Camera],
    hollows: Hollows,
    threads: int | None = None,
) -> Explained:
    """Estimate the normals of points from a flash's shading, by photometric stereo.

    points, normals [P,3]: those read in the cameras' photographs; hollows: their ambient occlusion and interreflection.
    """
    lamps = flash.lamps(cameras)
    sky, thrown = hollows.at(points, readings.photographs)

    def explain(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        some = readings.at(part)
        towards = (lamps[some.photographs] - points[part, None]).astype(np.float32)
        distances = np.linalg.norm(towards, axis=-1)
        besides = (flash.ambient * sky[part, None] + flash.bounced * thrown[part]) * distances**2
        brightness, weights = some.brightness * distances**2, some.weights**2
        return _solve(towards / distances[..., None], brightness, besides, weights, normals[part])

    parts = np.array_split(np.arange(len(points)), -(-len(points) // CHUNK))
    solved, known = (np.concatenate(column) for column in zip(*map_ahead(explain, parts, threads), strict=True))
    return Explained(solved, np.where(readings.counts >= MIN_READINGS, 1 / (1 + (known / KNOWN) ** 2), 0))


def albedos(
    readings: Readings,
    points: np.ndarray,
    normals: np.ndarray,
    flash: Flash,
    cameras: Sequence[Camera],
    hollows: Hollows,
) -> np.ndarray:
    """Estimate the albedo [P] of points [P,3] with unit normals [P,3], without highlights.

    It is their brightness in a light of 1; 0 where no photograph tells.
    """
    sky, thrown = hollows.at(points, readings.photographs)
    lamp = lamp_light(flash.lamps(cameras)[readings.photographs] - points[:, None], normals[:, None])
    light = lamp + flash.ambient * sky[:, None] + flash.bounced * thrown
    brightness = readings.brightness.astype(float)
    weights = current = readings.weights**2
    for _ in range(ROUNDS):
        albedo = scale(brightness, light, current)
        current = trusted(brightness - albedo[:, None] * light, weights, current)
    clipped: np.ndarray = np.maximum(albedo, 0)
    return clipped


def _solve(
    towards: np.ndarray, brightness: np.ndarray, besides: np.ndarray, weights: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for unit normals [P,3] by robust least squares, with their standard deviations [P] in radians.

    Without the lamp's falloff, brightness [P,K] = albedo * (cosine of the tilt + besides [P,K]). towards [P,K,3]: unit
    directions to the lamp; weights [P,K]; normals [P,3]: the surface's own. Readings that do not fit lose weight.
    """
    current, solved = weights, normals
    products = np.stack([towards[..., i] * towards[..., j] for i, j in _PAIRS], axis=1)
    for _ in range(ROUNDS):
        own = OWN * current.sum(axis=1)
        cosines = np.maximum(np.einsum("pki,pi->pk", towards, solved), 0)
        albedo = scale(brightness, cosines + besides, current)
        lit = brightness - albedo[:, None] * besides
        matrix = (products @ current[..., None])[:, _PLACES, 0] + (own + 1e-9)[:, None, None] * np.eye(3)
        right = np.einsum("pki,pk->pi", towards, lit * current) + (own * albedo)[:, None] * normals
        tilted = np.linalg.solve(matrix, right[..., None])[..., 0]
        left = lit - np.einsum("pki,pi->pk", towards, tilted)
        current = trusted(left, weights, current)
        solved = tilted / np.maximum(np.linalg.norm(tilted, axis=1, keepdims=True), 1e-9)
    spread = np.trace(np.linalg.inv(matrix), axis1=1, axis2=2)
    return solved, deviation(left, current) / np.maximum(albedo, 1e-9) * np.sqrt(spread)


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix's entries
_PLACES = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # where each entry stands among them


def scale(brightness: np.ndarray, shape: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the factor [P] that brings shape [P,K] closest to brightness [P,K], by weighted least squares."""
    albedo: np.ndarray = (brightness * shape * weights).sum(1) / np.maximum((shape * shape * weights).sum(1), 1e-9)
    return albedo


def deviation(left: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted root mean square [P] of the residuals [P,K]."""
    deviations: np.ndarray = np.sqrt((weights * left * left).sum(1) / np.maximum(weights.sum(1), 1e-9))
    return deviations


def trusted(left: np.ndarray, weights: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return robust weights [P,K]: lower where a residual is larger than usual by the current weights.

    left, weights, current [P,K]: the residuals, the weights without regard to them, and those of the round before.
    Bright outliers, such as highlights, lose more than dark ones.
    """
    spread = deviation(left, current)[:, None] + 1e-6
    high, low = np.maximum(left, 0) / (ABOVE * spread), np.minimum(left, 0) / (BELOW * spread)
    reduced: np.ndarray = weights / ((1 + high**2) * (1 + low**2))
    return reduced
