"""How far masks contradict each other along their contours.

Exact masks all touch their visual hull. Where a mask is too large, the others cut the hull back; where it is too small,
it cuts back what the others show. A mask that misses a whole part, as those of segmentation networks do, would cut that
part off the hull, so its view is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config.expert import MaskErrorOptions
from mgsr.data.hull import Hull, carve, signed_field, view_field
from mgsr.data.scene import Scene, View, some_of
from mgsr.data.silhouettes import Silhouette, view_silhouettes
from mgsr.data.valid_mask import valid_inside
from mgsr.parallel import map_ahead


def with_mask_error(scene: Scene) -> Scene:
    """Return the scene with the error of its given masks, without views whose masks miss what the others show.

    Notes say which views are left out, and that masks are inexact; wrong poses may be the cause, too.
    """
    if not scene.masked or scene.masks_found:
        return scene
    train, notes = list(scene.train), list(scene.notes)
    incomplete, error = find_mask_errors(train, scene.options.mask_error)
    kept = [index for index in range(len(train)) if index not in incomplete]
    if incomplete:
        names = ", ".join(repr(train[index].name) for index in incomplete)
        text = f"the masks of {len(incomplete)} of {len(train)} training views miss parts that the others show"
        notes.append(f"{text} ({names}); these views are skipped")
    measured = replace(scene, train=[train[index] for index in kept], mask_error=error)
    if measured.masks_inexact:
        notes.append(
            f"the contours of the masks contradict each other by {error:.1f} pixels in the median, because the masks "
            "or the poses are inexact; the surface follows them less closely"
        )
    return replace(measured, notes=tuple(notes))


def find_mask_errors(views: Sequence[View], options: MaskErrorOptions = MaskErrorOptions()) -> tuple[list[int], float]:
    """Return the indices of the few views whose masks miss parts of the object, and the `mask_error` of the others.

    Such a mask cuts the hull, so that many contours lie far outside it, and it is what most of them lie outside of. If
    such masks are too many, it is unknown which masks are right, and no index is returned. views: with masks of an
    object in the unit ball.
    """
    incomplete, contours = _find_incomplete(view_silhouettes(views, options.contour_side), options)
    return incomplete, contours.error


def mask_error(views: Sequence[View], options: MaskErrorOptions = MaskErrorOptions()) -> float:
    """Return the median distance, in pixels, of the masks' contours to the contours of their common visual hull.

    It is 0 if no contour is in sight. views: with masks of an object in the unit ball.
    """
    return _Contours.of(view_silhouettes(views, options.contour_side), options).error


def _find_incomplete(silhouettes: Sequence[Silhouette], options: MaskErrorOptions) -> tuple[list[int], _Contours]:
    """Find the incomplete masks one by one; also return the contours of the others."""
    incomplete: list[int] = []
    contours = first = _Contours.of(silhouettes, options)
    while len(incomplete) <= options.max_incomplete * len(silhouettes):
        worst = int(contours.cutting.argmax())
        if contours.cutting[worst] < max(options.least_cut, options.concentrated * contours.cutting.mean()):
            return sorted(incomplete), contours
        kept = [index for index in range(len(silhouettes)) if index not in incomplete]
        incomplete.append(kept.pop(worst))
        if len(kept) < options.min_views:
            break
        contours = _Contours.of([silhouettes[index] for index in kept], options)
    return [], first


@dataclass(frozen=True)
class _Contours:
    """How pixels on the contours of masks lie to the hull of all masks.

    error: the median distance, in pixels, by which they lie outside the hull.
    cutting [V]: the number of pixels that lie far outside the hull because of each mask.
    """

    error: float
    cutting: np.ndarray

    @classmethod
    def of(cls, silhouettes: Sequence[Silhouette], options: MaskErrorOptions) -> _Contours:
        """Look at some pixels of some contours; all silhouettes carve the hull."""
        hull = carve(silhouettes, np.zeros(3), options.half, options.resolution)
        looked_at = some_of(silhouettes, options.views)
        parts = list(map_ahead(lambda each: _gaps(each, silhouettes, hull, options), looked_at, None))
        gaps, nearest = (np.concatenate(part) for part in zip(*parts, strict=True))
        if not len(gaps):
            return cls(0.0, np.zeros(len(silhouettes), int))
        error = float(np.median(gaps))
        far = nearest[gaps > max(options.far, options.far_errors * error)]
        fields = [np.where(seen, field, np.inf) for seen, field in (view_field(each, far) for each in silhouettes)]
        return cls(error, np.bincount(np.argmin(fields, axis=0), minlength=len(silhouettes)))


def _gaps(
    silhouette: Silhouette, silhouettes: Sequence[Silhouette], hull: Hull, options: MaskErrorOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far [P], in pixels, a mask's contour lies outside the hull's contour, at some of its pixels.

    The ray through a pixel comes as near to the hull as the contour of the hull is to the pixel. Also returns the
    points [P,3] where the rays are nearest to the hull. hull: a coarse hull, which tells about where that is.
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

    ray, middle, reach = np.arange(len(rows)), camera.cam_from_world[2, 3], np.sqrt(3) * options.half
    first = max(middle - reach, hull.voxel)
    depths = np.arange(first, max(middle + reach, first + hull.voxel), hull.voxel)[:, None].repeat(len(rows), 1)
    coarse = hull.values(along(depths)).reshape(depths.shape)
    around = depths[coarse.argmax(axis=0), ray]
    depths = around + hull.voxel * np.linspace(-1.5, 1.5, options.steps)[:, None]
    fine = signed_field(silhouettes, along(depths))[0].reshape(depths.shape)
    size = around / np.sqrt(camera.K[0, 0] * camera.K[1, 1])  # of a pixel there
    gaps: np.ndarray = silhouette.distance[rows, columns] - fine.max(axis=0) / size
    return gaps, along(depths[fine.argmax(axis=0), ray][None])
