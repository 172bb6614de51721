"""Masks that agree with each other: what nearly all views show as the object is the object's in every view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, carve
from mgsr.data.silhouettes import Silhouette, signed_distance
from mgsr.geometry.raycast import RayCaster
from mgsr.segmentation.support_plane import SupportPlane

RESOLUTION = 128  # voxels along a side
HALF = 0.6  # of a box's longest side, half the side of the cube that is carved
SUNK = 1.0  # pixels under the support plane that the object may reach


def tolerant_hull(
    masks: Sequence[np.ndarray], cameras: Sequence[Camera], box: np.ndarray, plane: SupportPlane | None, dissent: float
) -> Hull:
    """Return the visual hull of masks of which a share `dissent`, and one at least, may leave out any place.

    masks [H,W] 0..1, one for each camera; box [2,3]: corners of a box around the object, in the cameras' frame; plane:
    what the object stands on, which cuts the hull off.
    """
    outlines = [Silhouette(camera, signed_distance(mask)) for mask, camera in zip(masks, cameras, strict=True)]
    wrong = max(1, int(dissent * len(outlines)))
    hull = carve(outlines, box.mean(axis=0), HALF * float((box[1] - box[0]).max()), RESOLUTION, wrong)
    if plane is None:
        return hull
    # Heights are linear, so those of the axes add up.
    axes = hull.origin + np.arange(RESOLUTION)[:, None] * hull.voxel
    along = [axes[:, i] * plane.normal[i] for i in range(3)]
    heights = along[0][:, None, None] + along[1][None, :, None] + along[2][None, None, :] + plane.offset
    above = heights + SUNK * pixel_size(cameras, np.zeros(3))
    return replace(hull, field=np.minimum(hull.field, above).astype(np.float32))


def silhouette(caster: RayCaster, camera: Camera) -> np.ndarray:
    """Return the signed distances [H,W], pixels, to a surface's silhouette in a camera, positive inside."""
    return signed_distance((caster.cast(camera).depth > 0).astype(np.float32))
