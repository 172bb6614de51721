"""Observations of a surface: the brightness of its points in the photographs that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from mgsr.config.expert import ObservationOptions
from mgsr.data.camera import Camera
from mgsr.data.photograph import Photograph
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.vectors import dots, lengths
from mgsr.parallel import map_ahead

INSIDE = 0.99  # least interpolated value of a mask at a pixel whose neighbours all lie inside


@dataclass(frozen=True)
class Observations:
    """Observations of P points, each in at most K photographs, float32.

    view_directions [P,K,3]: unit directions to the camera, in the scene's frame.
    distances [P,K]: the distance to the camera, in the scene's unit.
    brightness [P,K]: the mean of the channels in linear light.
    weights [P,K]: the cosine of the tilt where the point is visible at a usable pixel, else 0.
    photographs [P,K] int: the photographs' indices.
    """

    view_directions: np.ndarray
    distances: np.ndarray
    brightness: np.ndarray
    weights: np.ndarray
    photographs: np.ndarray

    @property
    def counts(self) -> np.ndarray:
        """Return the number [P] of photographs that observe each point."""
        seen: np.ndarray = (self.weights > 0).sum(axis=1)
        return seen

    def at(self, points: np.ndarray) -> Observations:
        """Return the observations of the points with the given indices [Q]."""
        return Observations(*(array[points] for array in _arrays(self)))

    def frontal(self, least: float) -> Observations:
        """Return the observations with weight 0 for those at a cosine below `least`."""
        return replace(self, weights=np.where(self.weights >= least, self.weights, 0))


def observe_photographs(
    mesh: Mesh,
    photographs: Sequence[Photograph],
    gap: float,
    threads: int | None = None,
    lamps: np.ndarray | None = None,
    options: ObservationOptions = ObservationOptions(),
) -> Observations:
    """Sample the photographs' brightness at the vertices of a mesh.

    gap: the largest depth of a vertex behind the mesh, in the scene's unit. lamps [N,3]: the lamp's position for each
    photograph, in the scene's frame; a vertex in its shadow counts as not visible. Each vertex keeps at most
    `options.count` observations, the most frontal ones.
    """
    count = len(mesh.vertices)

    def read(index: int) -> tuple[np.ndarray, ...]:
        """Return the arrays of one photograph's observations, each [V] or [V,3]."""
        lamp = None if lamps is None else lamps[index]
        return *_read(mesh, photographs[index], lamp, gap, options.min_cosine), np.full(count, index)

    parts = list(map_ahead(read, range(len(photographs)), threads))
    observations = Observations(*(np.stack(column, axis=1) for column in zip(*parts, strict=True)))
    if len(photographs) <= options.count:
        return observations
    best = np.argpartition(observations.weights, -options.count, axis=1)[:, -options.count :]
    rows = np.arange(count)[:, None]
    return Observations(*(array[rows, best] for array in _arrays(observations)))


def seen_frontal(
    caster: RayCaster,
    camera: Camera,
    points: np.ndarray,
    normals: np.ndarray,
    frontal: np.ndarray,
    gap: float,
    valid_mask: np.ndarray | None = None,
) -> np.ndarray:
    """Return the indices [Q] of the frontal points that a camera sees.

    points [P,3]: of a mesh, in the scene's frame. normals [P,3]: unit. frontal [P] bool: which points face the camera.
    gap: the largest depth of a point behind the mesh, in the scene's unit. valid_mask [H,W] bool: as for
    `RayCaster.sees`.
    """
    index = np.flatnonzero(frontal)
    seen: np.ndarray = index[caster.sees(camera, points[index] + normals[index] * gap, gap, valid_mask)]
    return seen


def sample_image(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Sample an image [H,W] bilinearly at `pixels` [P,2], whose centres lie at +0.5, clamped at the border."""
    values: np.ndarray = map_coordinates(image, [pixels[:, 1] - 0.5, pixels[:, 0] - 0.5], order=1, mode="nearest")
    return values


def lie_within(mask: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return which of the `pixels` [P,2] have only neighbours inside a mask [H,W] bool, as [P] bool."""
    return sample_image(mask.astype(np.float32), pixels) > INSIDE


def _arrays(observations: Observations) -> tuple[np.ndarray, ...]:
    """Return the arrays of the observations, [P,K] or [P,K,3], in the order of the fields."""
    return (
        observations.view_directions,
        observations.distances,
        observations.brightness,
        observations.weights,
        observations.photographs,
    )


def _read(
    mesh: Mesh, photograph: Photograph, lamp: np.ndarray | None, gap: float, min_cosine: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sample one photograph at a mesh's V vertices: directions [V,3], distances, brightness and weights [V] each.

    lamp [3]: the lamp's position in the scene's frame, or None. gap: the largest depth of a vertex behind the mesh.
    min_cosine: the least cosine between normal and view direction.
    """
    caster, points, normals = mesh.caster, mesh.vertices, mesh.double_normals
    camera = photograph.camera
    offsets = (camera.center - points).astype(np.float32)
    distances = lengths(offsets)
    view_directions = offsets / distances[:, None]
    cosines = dots(view_directions, normals)
    index = seen_frontal(caster, camera, points, normals, cosines > min_cosine, gap, photograph.interior)
    if lamp is not None:
        index = index[caster.reached(lamp, points[index] + normals[index] * gap, gap)]
    pixels, _ = camera.project(points[index])
    brightness, weights = np.zeros((2, len(points)), np.float32)
    brightness[index] = sample_image(photograph.brightness, pixels)
    weights[index] = cosines[index] * lie_within(photograph.usable, pixels)
    return view_directions, distances, brightness, weights
