"""Vertex colours of a surface, blended from the views that see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config.expert import ColorOptions
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.vectors import dots, lengths
from mgsr.mesh.pixels import depth_limits
from mgsr.mesh.views import SurfaceView, nearest, project, sample
from mgsr.parallel import map_ahead


def vertex_colors(
    mesh: Mesh,
    views: Sequence[SurfaceView],
    min_alpha: float,
    tolerance: float,
    threads: int | None = None,
    options: ColorOptions = ColorOptions(),
) -> np.ndarray:
    """Return vertex colours [V,3] float32 sRGB 0..1 (`blended_colors`).

    A vertex that no view shows takes the colour of the nearest visible vertex.
    """
    vertices = mesh.vertices
    colors, seen = blended_colors(vertices, mesh.normals, views, min_alpha, tolerance, threads, options)
    if seen.any() and not seen.all():
        colors[~seen] = colors[seen][cKDTree(vertices[seen]).query(vertices[~seen])[1]]
    return colors


def blended_colors(
    points: np.ndarray,
    normals: np.ndarray,
    views: Sequence[SurfaceView],
    min_alpha: float,
    tolerance: float,
    threads: int | None = None,
    options: ColorOptions = ColorOptions(),
) -> tuple[np.ndarray, np.ndarray]:
    """Blend the colours of surface points from the views that show them.

    points [P,3]: in the scene's frame. normals [P,3]: unit. A view shows a point that faces it and lies within
    `tolerance` pixel footprints of its depth. Returns colours [P,3] float32 sRGB 0..1, and which points any view shows,
    [P] bool. A colour is a weighted mean: head-on views count more, and colours far from the mean count less.
    """

    points, normals = (np.asarray(each, np.float32) for each in (points, normals))

    def read(view: SurfaceView) -> _ViewColors:
        shown = shown_points(points, normals, view, min_alpha, tolerance, options.grazing)
        return _ViewColors(shown.index, sample(view.color, shown.pixels), shown.weights)

    samples = list(map_ahead(read, views, threads))
    mean, total = _blend(samples, len(points), None, options)
    for _ in range(options.rounds):
        mean, _ = _blend(samples, len(points), mean, options)
    return np.clip(mean, 0, 1), total > 0


@dataclass(frozen=True)
class ShownPoints:
    """The points that one view shows: their indices [Q], pixels [Q,2] float32, and weights [Q].

    A weight is the squared cosine between the normal and the direction to the camera.
    """

    index: np.ndarray
    pixels: np.ndarray
    weights: np.ndarray


def shown_points(
    points: np.ndarray, normals: np.ndarray, view: SurfaceView, min_alpha: float, tolerance: float, grazing: float
) -> ShownPoints:
    """Find the points [P,3] with unit normals [P,3], both float32, that a view shows.

    They face the view at a cosine above `grazing`, and lie within `tolerance` pixel footprints of its depth.
    """
    center = view.camera.center.astype(np.float32)
    facing = np.flatnonzero(normals @ center > dots(points, normals))
    inside, pixels, depths = project(view.camera, points[facing])
    index = facing[inside]
    to_camera = center - points[index]
    cosines = dots(to_camera, normals[index]) / lengths(to_camera)
    limit = depth_limits(tolerance, depths, cosines, view.camera)
    shown = (cosines > grazing) & (np.abs(nearest(view.depth, pixels) - depths) <= limit)
    shown &= nearest(view.usable(min_alpha), pixels)
    return ShownPoints(index[shown], pixels[shown], cosines[shown] ** 2)


def robust_weights(weights: np.ndarray, off: np.ndarray, deviation: float) -> np.ndarray:
    """Reduce weights [Q] by the differences `off` [Q,3] of colours; a difference of `deviation` halves a weight."""
    reduced: np.ndarray = weights / (1 + (off * off).sum(1) / deviation**2)
    return reduced


@dataclass(frozen=True)
class _ViewColors:
    """The points that one view shows: their indices [Q], colors [Q,3] sRGB 0..1, and weights [Q]."""

    index: np.ndarray
    colors: np.ndarray
    weights: np.ndarray


def _blend(
    samples: Sequence[_ViewColors], count: int, around: np.ndarray | None, options: ColorOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted mean colours [V,3] and the sums of the weights [V].

    around [V,3]: the mean of the previous round; colours far from it lose weight. None: all keep their weights.
    """
    sums, total = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    for shown in samples:
        weights = shown.weights
        if around is not None:
            weights = robust_weights(weights, shown.colors - around[shown.index], options.deviation)
        sums[shown.index] += shown.colors * weights[:, None]
        total[shown.index] += weights
    return sums / np.maximum(total, 1e-12)[:, None], total
