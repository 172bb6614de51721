"""Points on everything in view, from depth maps of scenes without masks.

Confirmed depths give points that are as dense as the photographs resolve them. Regions without contrast, such as plain
walls, continue the depths around them where other photographs confirm that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config.expert import SceneStereoOptions
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.scene import PointCloud, View
from mgsr.geometry.raycast import pixel_rays
from mgsr.parallel import map_ahead
from mgsr.start.depth_filling import fill_depth
from mgsr.start.scene_depths import DepthMaps, scene_photographs
from mgsr.stereo.photographs import StereoPhotographs


def scene_points(
    views: Sequence[View], found: DepthMaps, options: SceneStereoOptions = SceneStereoOptions()
) -> PointCloud:
    """Return points on everything in view, in the scene's frame, with the views' colours; the result may be empty.

    found: the `scene_depths` of these views, or of the same views at another exposure.
    """
    photographs = scene_photographs(views, options)
    spacing = options.spacing * pixel_size(found.cameras, np.zeros(3))
    points = _confirmed_points(photographs, found, spacing, options.min_in_cell)
    filled = _filled_points(photographs, found, options)
    return points.joined(_apart(filled, points, options.spacing_filled))


def _confirmed_points(photographs: StereoPhotographs, found: DepthMaps, spacing: float, least: int) -> PointCloud:
    """Return the mean, by confidence, of the confirmed points in each contracted cell of size `spacing`.

    Cells with fewer than `least` points are left out, as most wrong depths lie alone.
    """
    depths = [found.known(view, camera) for view, camera in enumerate(found.cameras)]
    points, weights = _cloud(photographs, depths), np.concatenate([known[known > 0] for known in found.confidence])
    cells = contracted_cells(points.positions, spacing)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell = cell.ravel()

    def means(values: np.ndarray) -> np.ndarray:
        sums = np.stack([np.bincount(cell, weights * column) for column in values.T], axis=1)
        of_cells: np.ndarray = (sums / np.bincount(cell, weights)[:, None])[count >= least]
        return of_cells

    return PointCloud(means(points.positions), means(points.colors).round().astype(np.uint8))


def _filled_points(photographs: StereoPhotographs, found: DepthMaps, options: SceneStereoOptions) -> PointCloud:
    """Return points in regions without contrast, where enough views continue their depths to the same place."""
    small = photographs.reduced(options.coarser)

    def fill(view: int) -> np.ndarray:
        image, known = small.images[view], found.known(view, small.cameras[view])
        inverse = np.divide(1, known, out=np.zeros_like(known), where=known > 0)
        filled = fill_depth(inverse, 255 * image[..., :3], options.filling)
        return np.where(np.isfinite(filled) & (image[..., 3] > 0.5), 1 / filled, 0)

    whole = list(map_ahead(fill, range(len(small.images)), None))
    kept = [_agreed(view, small.cameras, whole, options) for view in range(len(whole))]
    return _thinned(_cloud(small, kept), options.spacing_filled)


def _agreed(
    view: int, cameras: Sequence[Camera], maps: Sequence[np.ndarray], options: SceneStereoOptions
) -> np.ndarray:
    """Return a view's depths [h,w] where enough other views have the same depth, and 0 elsewhere.

    maps [h,w]: every view's depths, camera z, 0 where unknown. More views must have the same depth than see through it.
    """
    depth = maps[view]
    rows, columns = np.nonzero(depth)
    points = _lifted(cameras[view], depth)
    confirming, against = np.zeros(len(points), int), np.zeros(len(points), int)
    for other, (camera, found) in enumerate(zip(cameras, maps, strict=True)):
        if other == view:
            continue
        at, pixels, depths = camera.project_inside(points)
        across, down = pixels.astype(int).T
        there = found[down, across]
        gaps = there / depths - 1
        confirming[at] += (there > 0) & (np.abs(gaps) < options.same_filled)
        against[at] += (there > 0) & (gaps > 2 * options.same_filled)
    good = (confirming >= options.min_confirming_filled) & (confirming > against)
    kept = np.zeros_like(depth)
    kept[rows[good], columns[good]] = depth[rows[good], columns[good]]
    return kept


def _cloud(photographs: StereoPhotographs, depths: Sequence[np.ndarray]) -> PointCloud:
    """Return the points of all views' depth maps [h,w], view by view and row by row, with their pixels' colours."""
    positions = [_lifted(camera, depth) for camera, depth in zip(photographs.cameras, depths, strict=True)]
    colors = [image[depth > 0, :3] for image, depth in zip(photographs.images, depths, strict=True)]
    return PointCloud(np.concatenate(positions), (255 * np.concatenate(colors)).round().clip(0, 255).astype(np.uint8))


def _lifted(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Return the points [P,3] of a depth map [h,w], camera z, row by row where it is above 0."""
    known = depth > 0
    points: np.ndarray = camera.center + pixel_rays(camera)[known] * depth[known][:, None].astype(np.float64)
    return points


def _thinned(points: PointCloud, spacing: float) -> PointCloud:
    """Return the first point of each cell of size `spacing` in contracted space (`_contracted`)."""
    cells = contracted_cells(points.positions, spacing)
    return points.rows(np.sort(np.unique(cells, axis=0, return_index=True)[1]))


def contracted_cells(positions: np.ndarray, spacing: float) -> np.ndarray:
    """Return the cells [P,3] int64, of size `spacing` in contracted space, that contain points [P,3]."""
    cells: np.ndarray = np.floor(_contracted(positions) / spacing).astype(np.int64)
    return cells


def _apart(points: PointCloud, others: PointCloud, spacing: float) -> PointCloud:
    """Return the points that are farther than `spacing`, in contracted space, from all points of `others`."""
    if not len(others) or not len(points):
        return points
    away = cKDTree(_contracted(others.positions)).query(_contracted(points.positions))[0]
    return points.rows(away > spacing)


def _contracted(positions: np.ndarray) -> np.ndarray:
    """Contract points [P,3] outside the unit ball into a ball of radius 2, with infinity on its surface.

    Photographs taken around the ball resolve distant places less finely (Barron and others 2022).
    """
    radius = np.maximum(np.linalg.norm(positions, axis=1, keepdims=True), 1)
    contracted: np.ndarray = positions * (2 - 1 / radius) / radius
    return contracted
