"""Normals from a flash: where the light sits on the camera, how bright a point is tells how it is tilted.

For a matte surface lit from the camera's place, brightness times the squared distance is albedo x cosine of the tilt
(Lambert), in linear light. Several views of a point give three unknowns, its normal times its albedo, by least squares
(photometric stereo, Woodham 1980); highlights are brighter than that and lose their weight in rounds. The normals then
bend the surface where they know more than its positions: in what is small (Nehab and others 2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from mgsr.data.camera import pixel_size
from mgsr.data.scene import View
from mgsr.geometry.displace import bend_to_normals, edge_length
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import vertex_normals
from mgsr.mesh.parallel import map_ahead

MIN_COS = 0.25  # of the tilt; what is seen more grazing is left out
MIN_VIEWS = 5  # that see a vertex, or nothing is said of it
SOLID = 0.97  # of alpha; pixels under it mix object and background
CLIPPED = 0.98  # of the brightest channel; pixels above it hide how bright they were
OWN = 0.02  # weight of the surface's own normal beside the photographs'
ROUNDS = 5  # of least squares with new weights
ABOVE, BELOW = 0.5, 1.5  # deviations at which a reading that is too bright, or too dark, counts half
BLEND = 14.0  # pixels; finer shape comes from the normals, coarser from the positions
CHUNK = 40_000  # vertices at a time, to bound memory


def refine_by_flash(
    vertices: np.ndarray, faces: np.ndarray, photographs: Sequence[View], max_ratio: float, threads: int | None = None
) -> np.ndarray:
    """The vertices [V,3] moved along their normals so that shading by a flash explains the photographs, if it does.

    max_ratio: what the deviations from such shading may be at most, against those from one colour in all views; under
    a light that stands still shading by the camera explains less than nothing, and the vertices stay.
    """
    normals, caster = vertex_normals(vertices, faces).astype(np.float64), RayCaster(vertices, faces)
    pixel = pixel_size([view.camera for view in photographs], vertices.mean(axis=0))
    parts = [
        _tilts(caster, vertices[part], normals[part], photographs, pixel, threads)
        for part in np.array_split(np.arange(len(vertices)), max(1, -(-len(vertices) // CHUNK)))
    ]
    ratios = np.concatenate([part.ratios for part in parts])
    seen = np.isfinite(ratios)
    if not seen.any() or np.median(ratios[seen]) > max_ratio:
        return vertices
    wanted = np.concatenate([part.normals for part in parts])
    strength = (BLEND * pixel / (2 * np.pi * edge_length(vertices, faces))) ** 2
    return vertices + bend_to_normals(vertices, faces, normals, wanted, seen, strength)[:, None] * normals


@dataclass(frozen=True)
class _Tilts:
    """normals [P,3] that the shading tells; ratios [P]: deviations from shading against those from one colour, not
    finite where too few views see the vertex."""

    normals: np.ndarray
    ratios: np.ndarray


def _tilts(
    caster: RayCaster,
    points: np.ndarray,
    normals: np.ndarray,
    photographs: Sequence[View],
    pixel: float,
    threads: int | None,
) -> _Tilts:
    readings = list(map_ahead(lambda view: _read(caster, view, points, normals, pixel), photographs, threads))
    towards = np.stack([reading.towards for reading in readings], axis=1)
    brightness = np.stack([reading.brightness for reading in readings], axis=1)
    weights = np.stack([reading.weights for reading in readings], axis=1)
    cosines = np.maximum(np.einsum("pki,pi->pk", towards, normals), 0)
    shaded = _deviation(brightness - cosines * _scale(brightness, cosines, weights)[:, None], weights)
    plain = _deviation(brightness - _scale(brightness, np.ones_like(cosines), weights)[:, None], weights)
    enough = (weights > 0).sum(axis=1) >= MIN_VIEWS
    ratios = np.where(enough, shaded / np.maximum(plain, 1e-9), np.nan)
    return _Tilts(_solve(towards, brightness, weights, normals, cosines), ratios)


def _solve(
    towards: np.ndarray, brightness: np.ndarray, weights: np.ndarray, normals: np.ndarray, cosines: np.ndarray
) -> np.ndarray:
    """Unit normals [P,3] by least squares whose weights fall for readings that don't fit."""
    current = weights
    for _ in range(ROUNDS):
        own = OWN * current.sum(axis=1)
        albedo = _scale(brightness, cosines, current)
        matrix = np.einsum("pki,pkj->pij", towards * current[..., None], towards)
        matrix += (own + 1e-9)[:, None, None] * np.eye(3)
        right = np.einsum("pki,pk->pi", towards, brightness * current) + (own * albedo)[:, None] * normals
        solved = np.linalg.solve(matrix, right[..., None])[..., 0]
        left = brightness - np.einsum("pki,pi->pk", towards, solved)
        spread = _deviation(left, current)[:, None] + 1e-6
        current = weights / (1 + (np.maximum(left, 0) / (ABOVE * spread)) ** 2)
        current /= 1 + (np.minimum(left, 0) / (BELOW * spread)) ** 2
    return solved / np.maximum(np.linalg.norm(solved, axis=1, keepdims=True), 1e-9)


def _scale(brightness: np.ndarray, shape: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The factor [P] that brings shape [P,K] closest to the brightness."""
    return (brightness * shape * weights).sum(1) / np.maximum((shape * shape * weights).sum(1), 1e-9)


def _deviation(left: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.sqrt((weights * left * left).sum(1) / np.maximum(weights.sum(1), 1e-9))


@dataclass(frozen=True)
class _Reading:
    """One photograph at the points: unit directions towards the camera [P,3], brightness [P] in linear light times the
    squared distance, and weights [P], 0 where the point is not seen or the pixel is of no use."""

    towards: np.ndarray
    brightness: np.ndarray
    weights: np.ndarray


def _read(caster: RayCaster, view: View, points: np.ndarray, normals: np.ndarray, gap: float) -> _Reading:
    offsets = view.camera.center - points
    distances = np.linalg.norm(offsets, axis=1)
    towards = offsets / distances[:, None]
    cosines = (towards * normals).sum(1)
    index = np.flatnonzero(cosines > MIN_COS)
    index = index[caster.sees(view.camera, points[index] + normals[index] * gap, gap)]
    light, usable = _light(view)
    pixels, _ = view.camera.project(points[index])
    places = [pixels[:, 1] - 0.5, pixels[:, 0] - 0.5]
    brightness, weights = np.zeros(len(points)), np.zeros(len(points))
    brightness[index] = map_coordinates(light, places, order=1, mode="nearest") * distances[index] ** 2
    whole = map_coordinates(usable, places, order=1, mode="nearest") > 0.99
    weights[index] = whole * cosines[index] ** 2
    return _Reading(towards, brightness, weights)


def _light(view: View) -> tuple[np.ndarray, np.ndarray]:
    """A photograph's brightness [H,W] in linear light, and 1 where it may be used, else 0."""
    srgb = view.image.astype(np.float32) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).mean(axis=-1)
    usable = srgb.max(axis=-1) <= CLIPPED
    if view.alpha is not None:
        usable &= view.alpha >= SOLID * 255
    return linear, usable.astype(np.float32)
