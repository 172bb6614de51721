"""Points that other views contradict: floating in space that they see through, or outside a silhouette."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt, minimum_filter

from mgsr.mesh.points import OrientedPoints
from mgsr.mesh.views import Silhouette, SurfaceView, in_image, nearest, sample


def agreed(points: OrientedPoints, views: Sequence[SurfaceView], min_alpha: float, tolerance: float) -> np.ndarray:
    """[P] bool: points that not more views contradict than confirm.

    A view contradicts a point when it sees something more than `tolerance` pixel footprints behind it, or nothing,
    at the point's pixel and all around it; it confirms a point that faces it and lies that close to its surface.
    Views that see something in front of the point are silent. Slanted surfaces get a wider tolerance.
    """
    for_it = np.zeros(len(points), np.int32)
    against = np.zeros(len(points), np.int32)
    for view in views:
        index, gap, limit, facing, empty = _compare(points, view, min_alpha, tolerance)
        against[index] += empty | (gap > limit)
        for_it[index] += facing & (np.abs(gap) <= limit)
    return (against < 2) | (against <= for_it)


def _compare(
    points: OrientedPoints, view: SurfaceView, min_alpha: float, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """For the points inside a view's image: their indices, how far behind them the nearest surface around their pixel
    lies, the tolerance, whether they face the camera, and whether nothing is there at all."""
    camera = view.camera
    pixels, depths = camera.project(points.positions)
    index = np.flatnonzero(in_image(camera, pixels, depths))
    depths, pixels = depths[index], pixels[index]
    # The nearest of the 3x3 pixels around: a point at a silhouette is not contradicted by what lies past it.
    around = minimum_filter(np.where(view.usable(min_alpha), view.depth, np.inf), size=3)
    seen = nearest(around, pixels)
    to_camera = camera.center - points.positions[index]
    cosines = (to_camera * points.normals[index]).sum(1) / np.linalg.norm(to_camera, axis=1)
    limit = tolerance * depths / camera.K[0, 0] / np.maximum(np.abs(cosines), 0.3)
    return index, seen - depths, limit, cosines > 0, np.isinf(seen)


class Hull:
    """The space that all silhouettes allow."""

    def __init__(self, silhouettes: Sequence[Silhouette]) -> None:
        self._cameras = [silhouette.camera for silhouette in silhouettes]
        self._outside = [_pixels_outside(silhouette.inside) for silhouette in silhouettes]

    def excess(self, points: np.ndarray, margin: float) -> np.ndarray:
        """How far [P] the points [P,3] must at least move to come within `margin` pixels of every silhouette that has
        them in its image, in the scene's unit; 0 for those that do already."""
        worst = np.zeros(len(points))
        for camera, outside in zip(self._cameras, self._outside, strict=True):
            pixels, depths = camera.project(points)
            index = np.flatnonzero(in_image(camera, pixels, depths))
            over = np.maximum(sample(outside, pixels[index]) - margin, 0) * depths[index] / camera.K[0, 0]
            worst[index] = np.maximum(worst[index], over)
        return worst


def _pixels_outside(inside: np.ndarray) -> np.ndarray:
    """The distance [H,W] from each pixel's centre to the nearest one inside; 0 inside."""
    if not inside.any():
        return np.full(inside.shape, float(max(inside.shape)), np.float32)
    return distance_transform_edt(~inside).astype(np.float32)
