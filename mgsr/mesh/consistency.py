"""Multi-view consistency of points, and the visual hull.

Points that other views see through, or that lie outside a silhouette, are inconsistent. The others move to the surface
on which the views agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import minimum_filter

from mgsr.config.expert import MeshOptions
from mgsr.data.hull import keep_lowest
from mgsr.data.silhouettes import Silhouette
from mgsr.mesh.pixels import PixelRules, depth_limits, surface_pixels
from mgsr.mesh.points import OrientedPoints
from mgsr.mesh.views import SurfaceView, nearest, project, sample
from mgsr.parallel import map_ahead


@dataclass(frozen=True)
class Agreement:
    """The result of comparing points with all views.

    moved: the points [P] on the mean surface of the confirming views. agreed [P] bool: True where at most one view
    contradicts the point, or where no more views contradict it than confirm it.
    """

    moved: OrientedPoints
    agreed: np.ndarray


def compare_views(
    points: OrientedPoints,
    views: Sequence[SurfaceView],
    rules: PixelRules,
    tolerance: float,
    threads: int | None = None,
    reach: float = MeshOptions().confirm_reach,
) -> Agreement:
    """Compare points with every view, and move them to the surface on which the confirming views agree.

    A view contradicts a point if all 3x3 pixels around the point show a surface more than `tolerance` pixel footprints
    behind it, or none. The limit is larger where the surface is slanted. A view confirms a point that faces it and lies
    within `reach` times that limit of its surface. A view is silent about points that its surface or its mask hides.

    Confirming views move the point along its normal to their mean surface, and turn its normal to their mean normal.

    A view's weight falls smoothly to 0 at its border. Neighbouring points are therefore averaged over nearly the same
    views, and differences between the views' depths do not become noise on the surface. For the same reason, pixels
    count down to half of rules.min_cos, with a low weight.
    """
    rules = replace(rules, min_cos=rules.min_cos / 2)
    count = len(points)
    against, confirming = np.zeros(count, np.int32), np.zeros(count, np.int32)
    sums = np.zeros((count, 5), np.float32)  # weight, weight * offset along the normal, weight * normal
    for verdict in map_ahead(lambda view: _verdict(points, view, rules, tolerance, reach), views, threads):
        against[verdict.contradicted] += 1
        confirming[verdict.confirmed] += 1
        sums[verdict.confirmed] += verdict.weights[:, None] * np.column_stack(
            [np.ones_like(verdict.offsets), verdict.offsets, verdict.normals]
        )
    return Agreement(_moved(points, sums), (against < 2) | (against <= confirming))


def _moved(points: OrientedPoints, sums: np.ndarray) -> OrientedPoints:
    """Move points by the sums [P,5] of weight, weighted offset along the normal, and weighted normal."""
    offsets = sums[:, 1] / np.maximum(sums[:, 0], 1e-9)
    turned = np.where(sums[:, :1] > 0, sums[:, 2:], points.normals)
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    normals = np.where(lengths > 1e-6, turned / np.maximum(lengths, 1e-6), points.normals)
    return OrientedPoints(points.positions + offsets[:, None] * points.normals, normals.astype(np.float32))


@dataclass(frozen=True)
class _Verdict:
    """One view's verdict on the points.

    contradicted [R]: the indices of the points that it contradicts. confirmed [Q]: the indices of those that it
    confirms, with weights [Q]. offsets [Q]: the distances to the view's surface along the points' normals, in the
    scene's unit. normals [Q,3]: the weighted normals of that surface.
    """

    contradicted: np.ndarray
    confirmed: np.ndarray
    weights: np.ndarray
    offsets: np.ndarray
    normals: np.ndarray


def _verdict(points: OrientedPoints, view: SurfaceView, rules: PixelRules, tolerance: float, reach: float) -> _Verdict:
    camera = view.camera
    index, pixels, depths = project(camera, points.positions)
    rays = (pixels - camera.K[:2, 2].astype(np.float32)) / camera.K[[0, 1], [0, 1]].astype(np.float32)
    turned = camera.cam_from_world[:3, :3].astype(np.float32) @ points.normals.T.astype(np.float32, copy=False)
    across, down, away = turned[:, index]
    slants = across * rays[:, 0] + down * rays[:, 1] + away  # component of a ray with camera z 1 along the normal
    cosines = -slants / np.sqrt(rays[:, 0] ** 2 + rays[:, 1] ** 2 + 1)
    limit = depth_limits(tolerance, depths, np.abs(cosines), camera)
    depth = np.where(view.usable(rules.min_alpha), view.depth, np.inf)
    if view.mask is not None:
        depth = np.where(view.mask, depth, 0)  # nearer than any point, so the view is silent there
    # The nearest of the 3x3 pixels around, so that the background does not contradict a point at a silhouette.
    contradicted = index[nearest(minimum_filter(depth, size=3), pixels) - depths > limit]
    limit = reach * limit
    # Interpolation is slow, so it is limited to candidates. It may shift a slanted surface, hence the factor 2.
    near = (cosines > rules.min_cos / 2) & (np.abs(nearest(depth, pixels) - depths) < 2 * limit)
    seen = sample(_weighted_surface(view, rules), pixels[near])
    gaps = seen[:, 1] / np.maximum(seen[:, 0], 1e-6) - depths[near]
    weights = seen[:, 0] * np.clip(1 - (gaps / limit[near]) ** 2, 0, 1) ** 2
    confirmed = weights > 0
    offsets = gaps * slants[near]
    return _Verdict(contradicted, index[near][confirmed], weights[confirmed], offsets[confirmed], seen[confirmed, 2:])


def _weighted_surface(view: SurfaceView, rules: PixelRules) -> np.ndarray:
    """Return a view's weights, weighted depths and weighted normals as one image [H,W,5].

    A pixel's weight falls to 0 at rules.min_cos.
    """
    pixels = surface_pixels(view, rules)
    weights = np.where(pixels.believed, pixels.cosines - rules.min_cos, 0)[..., None]
    values = np.concatenate([np.ones_like(weights), view.depth[..., None], pixels.normals], axis=-1)
    # A product alone would keep the NaNs of pixels without weight.
    return np.where(weights > 0, values * weights, 0)


class SilhouetteHull:
    """The visual hull: the space inside all silhouettes, or inside all but `dissent` of them."""

    def __init__(self, silhouettes: Sequence[Silhouette], dissent: int = 0) -> None:
        """Prepare the hull. dissent: the number of silhouettes that may exclude a point of the hull."""
        self._dissent = dissent
        self._cameras = [silhouette.camera for silhouette in silhouettes]
        self._outside = [_outside(silhouette) for silhouette in silhouettes]

    def excess(self, points: np.ndarray, margin: float) -> np.ndarray:
        """Return a lower bound [P] of the distance of points [P,3] to the hull, in the scene's unit; 0 inside.

        margin: the tolerance outside a silhouette, in pixels. A silhouette counts if the point projects to a valid
        pixel of its image.
        """
        lowest = np.zeros((self._dissent + 1, len(points)), np.float32)  # of the negative distances
        for camera, outside in zip(self._cameras, self._outside, strict=True):
            index, pixels, depths = project(camera, points)
            below = np.zeros(len(points), np.float32)
            below[index] = np.minimum(margin - nearest(outside, pixels), 0) * depths / camera.K[0, 0]
            keep_lowest(lowest, below)
        return -np.asarray(lowest[self._dissent])


def _outside(silhouette: Silhouette) -> np.ndarray:
    """Return each pixel's distance [h,w] to the silhouette, in pixels; 0 inside it and at invalid pixels."""
    distance = np.maximum(-silhouette.distance, 0)
    return distance if silhouette.valid_mask is None else np.where(silhouette.valid_mask, distance, 0)
