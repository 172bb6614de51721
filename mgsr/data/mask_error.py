"""How far masks contradict each other along their contours.

Exact masks all touch their visual hull. Where a mask is too large, the others cut the hull back; where it is too small,
it cuts back what the others show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsr.config.expert import MaskErrorOptions
from mgsr.data.hull import Hull, carve, signed_field
from mgsr.data.scene import Scene, View, some_of
from mgsr.data.silhouettes import Silhouette, view_silhouettes
from mgsr.data.valid_mask import valid_inside
from mgsr.parallel import map_ahead


def with_mask_error(scene: Scene) -> Scene:
    """Return the scene with the error of its given masks, and a note if it is large; wrong poses may cause it, too."""
    if not scene.masked or scene.masks_found:
        return scene
    measured = replace(scene, mask_error=mask_error(scene.train, scene.options.mask_error))
    if not measured.masks_inexact:
        return measured
    note = (
        f"the contours of the masks contradict each other by {measured.mask_error:.1f} pixels in the median, because "
        "the masks or the poses are inexact; the surface follows them less closely"
    )
    return replace(measured, notes=(*scene.notes, note))


def mask_error(views: Sequence[View], options: MaskErrorOptions = MaskErrorOptions()) -> float:
    """Return the median distance, in pixels, of the masks' contours to the contours of their common visual hull.

    It is 0 if no contour is in sight. views: with masks of an object in the unit ball.
    """
    silhouettes = view_silhouettes(views, options.contour_side)
    hull = carve(silhouettes, np.zeros(3), options.half, options.resolution)
    gaps = np.concatenate(
        list(map_ahead(lambda each: _gaps(each, silhouettes, hull, options), some_of(silhouettes, options.views), None))
    )
    return float(np.median(gaps)) if len(gaps) else 0.0


def _gaps(
    silhouette: Silhouette, silhouettes: Sequence[Silhouette], hull: Hull, options: MaskErrorOptions
) -> np.ndarray:
    """Return how far [P], in pixels, a mask's contour lies outside the hull's contour, at some of its pixels.

    The ray through a pixel comes as near to the hull as the contour of the hull is to the pixel. hull: a coarse hull of
    all silhouettes, which shows where the ray comes nearest.
    """
    camera, near = silhouette.camera, np.abs(silhouette.distance) < 1
    near &= valid_inside(np.ones_like(near) if silhouette.valid_mask is None else silhouette.valid_mask, 2)
    rows, columns = np.nonzero(near)
    every = max(len(rows) // options.pixels, 1)
    rows, columns = rows[::every], columns[::every]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.cam_from_world[:3, :3]  # of depth 1

    def along(depths: np.ndarray) -> np.ndarray:
        """Return the points [D*P,3] at depths [D,P] of the rays."""
        points: np.ndarray = (camera.center + depths[..., None] * rays).reshape(-1, 3)
        return points

    middle, reach = camera.cam_from_world[2, 3], np.sqrt(3) * options.half
    depths = np.arange(max(middle - reach, hull.voxel), middle + reach, hull.voxel)[:, None].repeat(len(rows), 1)
    coarse = hull.values(along(depths)).reshape(depths.shape)
    around = depths[coarse.argmax(axis=0), np.arange(len(rows))]
    depths = around + hull.voxel * np.linspace(-1.5, 1.5, options.steps)[:, None]
    fine = signed_field(silhouettes, along(depths))[0].reshape(depths.shape)
    size = around / np.sqrt(camera.K[0, 0] * camera.K[1, 1])  # of a pixel there
    gaps: np.ndarray = silhouette.distance[rows, columns] - fine.max(axis=0) / size
    return gaps
