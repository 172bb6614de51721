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

# Points in a batch, to bound the memory for all views' samples; a multiple of 8.
_POINTS_AT_ONCE = 1 << 19


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
    points = PointsInViews(vertices, mesh.normals, views, min_alpha, tolerance, options.grazing)
    colors, seen = blended_colors(points, threads, options)
    if seen.any() and not seen.all():
        colors[~seen] = colors[seen][cKDTree(vertices[seen]).query(vertices[~seen])[1]]
    return colors


@dataclass(frozen=True)
class ShownPoints:
    """The points that one view shows: their indices [Q], pixels [Q,2] float32, and weights [Q].

    A weight is the squared cosine between the normal and the direction to the camera.
    """

    index: np.ndarray
    pixels: np.ndarray
    weights: np.ndarray


class PointsInViews:
    """Points of a surface, and which of them each view shows.

    A view shows a point that faces it, and lies near its depth. This is found once, and remembered with one bit for
    each point and view.
    """

    def __init__(
        self,
        points: np.ndarray,
        normals: np.ndarray,
        views: Sequence[SurfaceView],
        min_alpha: float,
        tolerance: float,
        grazing: float,
    ) -> None:
        """Take points [P,3] and unit normals [P,3] in the frame of the views.

        tolerance: how far a point may lie from a view's depth, in pixel footprints. grazing: the least cosine between
        its normal and the direction to the camera.
        """
        self.views = views
        self._points, self._normals = (np.asarray(each, np.float32) for each in (points, normals))
        self._min_alpha, self._tolerance, self._grazing = min_alpha, tolerance, grazing
        self._known: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._points)

    def shown_by(self, view: int, first: int = 0, end: int | None = None) -> ShownPoints:
        """Return the points that the view with this number shows, from point `first` up to point `end`.

        first: a multiple of 8.
        """
        bits = self._known.get(view)
        if bits is None:
            bits = self._known[view] = np.packbits(self._shown(self.views[view]))
        end = len(self) if end is None else end
        among = first + np.flatnonzero(np.unpackbits(bits[first // 8 : (end + 7) // 8], count=end - first))
        camera = self.views[view].camera
        inside, pixels, _ = project(camera, self._points[among])
        index = among[inside]
        return ShownPoints(index, pixels, self._cosines(index, camera.center) ** 2)

    def _shown(self, view: SurfaceView) -> np.ndarray:
        """Return which points [P] bool a view shows."""
        center = view.camera.center.astype(np.float32)
        facing = np.flatnonzero(self._normals @ center > dots(self._points, self._normals))
        inside, pixels, depths = project(view.camera, self._points[facing])
        index = facing[inside]
        cosines = self._cosines(index, center)
        limit = depth_limits(self._tolerance, depths, cosines, view.camera)
        near = (cosines > self._grazing) & (np.abs(nearest(view.depth, pixels) - depths) <= limit)
        near &= nearest(view.usable(self._min_alpha), pixels)
        shown = np.zeros(len(self), bool)
        shown[index[near]] = True
        return shown

    def _cosines(self, index: np.ndarray, center: np.ndarray) -> np.ndarray:
        """Return the cosines [Q] between the normals of points and the directions to a camera's centre [3]."""
        to_camera = center.astype(np.float32) - self._points[index]
        return np.asarray(dots(to_camera, self._normals[index]) / lengths(to_camera))


def blended_colors(
    points: PointsInViews, threads: int | None = None, options: ColorOptions = ColorOptions()
) -> tuple[np.ndarray, np.ndarray]:
    """Blend the colours of P surface points from the views that show them.

    Returns colours [P,3] float32 sRGB 0..1, and which points any view shows, [P] bool. A colour is a weighted mean:
    head-on views count more, and colours far from the mean count less.
    """
    colors, seen = np.zeros((len(points), 3), np.float32), np.zeros(len(points), bool)
    for first in range(0, len(points), _POINTS_AT_ONCE):
        end = min(first + _POINTS_AT_ONCE, len(points))

        def read(view: int, first: int = first, end: int = end) -> _ViewColors:
            shown = points.shown_by(view, first, end)
            return _ViewColors(shown.index - first, sample(points.views[view].color, shown.pixels), shown.weights)

        samples = list(map_ahead(read, range(len(points.views)), threads))
        mean, total = _blend(samples, end - first, None, options)
        for _ in range(options.rounds):
            mean, _ = _blend(samples, end - first, mean, options)
        colors[first:end], seen[first:end] = np.clip(mean, 0, 1), total > 0
    return colors, seen


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
