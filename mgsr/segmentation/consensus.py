"""Masks that agree with each other: what nearly all views show as the object is the object's in every view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.hull import Hull, hull_surface, view_field
from mgsr.data.silhouettes import Silhouette, signed_distance
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead

RESOLUTION = 96  # voxels along the longest side of the box
MARGIN = 0.1  # of the box on each side, as a share of its longest side
CHUNK = 65_536  # voxels that are judged at a time
DISSENT = 0.02  # share of the views that may have a place outside their masks, though it is the object's


def completed_masks(masks: Sequence[np.ndarray], cameras: Sequence[Camera], box: np.ndarray) -> list[np.ndarray]:
    """Add to each mask what nearly all the other views show as the object.

    masks [H,W] bool, one for each camera; box [2,3]: corners of a box around the object, in the cameras' frame. A
    visual hull takes away what a single mask leaves out; this one lets a few masks be wrong. Returns [H,W] bool.
    """
    hull = _tolerant_hull(masks, cameras, box)
    if not (hull.field > 0).any():
        return list(masks)
    caster = Mesh(*hull_surface(hull)).caster
    return [mask | (caster.cast(camera).depth > 0) for mask, camera in zip(masks, cameras, strict=True)]


def _tolerant_hull(masks: Sequence[np.ndarray], cameras: Sequence[Camera], box: np.ndarray) -> Hull:
    """Return the hull of which a share DISSENT of the masks, and one at least, may leave out any place."""
    pairs = zip(masks, cameras, strict=True)
    outlines = [Silhouette(camera, signed_distance(mask.astype(np.float32))) for mask, camera in pairs]
    side = float((box[1] - box[0]).max())
    voxel = side * (1 + 2 * MARGIN) / RESOLUTION
    origin = box.mean(axis=0) - (RESOLUTION - 1) / 2 * voxel
    places = np.stack(np.meshgrid(*[np.arange(RESOLUTION)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    wrong = max(1, int(DISSENT * len(outlines)))

    def judged(first: int) -> np.ndarray:
        points = places[first : first + CHUNK] * voxel + origin
        fields = [view_field(outline, points) for outline in outlines]
        inside = np.stack([np.where(tells, distance, np.inf) for tells, distance in fields])
        told = np.sum([tells for tells, _ in fields], axis=0)
        field = np.partition(inside, wrong, axis=0)[wrong]
        return np.where((told > 2 * wrong) & np.isfinite(field), field, -voxel).astype(np.float32)

    parts = map_ahead(judged, range(0, len(places), CHUNK), None)
    return Hull(np.concatenate(list(parts)).reshape((RESOLUTION,) * 3), origin, voxel)
