"""Normals from a flash: where the light sits on the camera, how bright a point is tells how it is tilted.

For a matte surface lit from the camera's place, brightness times the squared distance is albedo x cosine of the tilt
(Lambert), in linear light. Several views of a point give three unknowns, its normal times its albedo, by least squares
(photometric stereo, Woodham 1980); highlights are brighter than that and lose their weight in rounds.
"""

from __future__ import annotations

import numpy as np

from mgsr.shading.explained import MIN_READINGS, Explained
from mgsr.shading.readings import Readings

OWN = 0.02  # weight of the surface's own normal beside the photographs'
ROUNDS = 5  # of least squares with new weights
ABOVE, BELOW = 0.5, 1.5  # deviations at which a reading that is too bright, or too dark, counts half


def flash_ratio(readings: Readings, normals: np.ndarray) -> float:
    """How far the readings are from a flash's shading of a surface with these normals [P,3], against how far they are
    from one brightness a point: the median over the points; infinite if there are none."""
    brightness, weights, cosines = _lambert(readings, normals)
    shaded = _deviation(brightness - cosines * _scale(brightness, cosines, weights)[:, None], weights)
    plain = _deviation(brightness - _scale(brightness, np.ones_like(cosines), weights)[:, None], weights)
    sure = readings.counts >= MIN_READINGS
    return float(np.median(shaded[sure] / np.maximum(plain[sure], 1e-9))) if sure.any() else np.inf


def explain_by_flash(readings: Readings, normals: np.ndarray) -> Explained:
    """What a light on the camera says of the normals [P,3] of the points that were read."""
    brightness, weights, cosines = _lambert(readings, normals)
    solved = _solve(readings.towards, brightness, weights, normals, cosines)
    return Explained(solved, readings.counts >= MIN_READINGS)


def _lambert(readings: Readings, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Brightness without the flash's falloff, weights, and cosines of the tilt, all [P,K]."""
    cosines = np.maximum(np.einsum("pki,pi->pk", readings.towards, normals), 0)
    return readings.brightness * readings.distances**2, readings.weights**2, cosines


def _solve(
    towards: np.ndarray, brightness: np.ndarray, weights: np.ndarray, normals: np.ndarray, cosines: np.ndarray
) -> np.ndarray:
    """Unit normals [P,3] by least squares whose weights fall for readings that don't fit."""
    current = weights
    products = np.stack([towards[..., i] * towards[..., j] for i, j in _PAIRS], axis=1)
    for _ in range(ROUNDS):
        own = OWN * current.sum(axis=1)
        albedo = _scale(brightness, cosines, current)
        matrix = (products @ current[..., None])[:, _PLACES, 0] + (own + 1e-9)[:, None, None] * np.eye(3)
        right = np.einsum("pki,pk->pi", towards, brightness * current) + (own * albedo)[:, None] * normals
        solved = np.linalg.solve(matrix, right[..., None])[..., 0]
        left = brightness - np.einsum("pki,pi->pk", towards, solved)
        spread = _deviation(left, current)[:, None] + 1e-6
        current = weights / (1 + (np.maximum(left, 0) / (ABOVE * spread)) ** 2)
        current /= 1 + (np.minimum(left, 0) / (BELOW * spread)) ** 2
    return solved / np.maximum(np.linalg.norm(solved, axis=1, keepdims=True), 1e-9)


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix's entries
_PLACES = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # where each entry stands among them


def _scale(brightness: np.ndarray, shape: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The factor [P] that brings shape [P,K] closest to the brightness."""
    return (brightness * shape * weights).sum(1) / np.maximum((shape * shape * weights).sum(1), 1e-9)


def _deviation(left: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.sqrt((weights * left * left).sum(1) / np.maximum(weights.sum(1), 1e-9))
