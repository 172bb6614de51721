"""A visual hull that tolerates errors in single masks, and the silhouettes of its surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import TolerantHullOptions
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, carve, cut_at
from mgsr.data.silhouettes import Silhouette, signed_distance
from mgsr.geometry.raycast import RayCaster
from mgsr.segmentation.support_plane import SupportPlane


def tolerant_hull(
    masks: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    box: np.ndarray,
    plane: SupportPlane | None,
    dissent: float,
    options: TolerantHullOptions = TolerantHullOptions(),
) -> Hull:
    """Carve a visual hull that keeps a place even if a few masks exclude it.

    masks [H,W] 0..1, one for each camera. box [2,3]: the least and the largest corner of a box around the object, in
    the world frame. plane: the support plane, which cuts the hull off. dissent: the share of the masks that may exclude
    a place; one mask always may.
    """
    silhouettes = [Silhouette(camera, signed_distance(mask)) for mask, camera in zip(masks, cameras, strict=True)]
    wrong = max(1, int(dissent * len(silhouettes)))
    half = options.half * float((box[1] - box[0]).max())
    hull = carve(silhouettes, box.mean(axis=0), half, options.resolution, wrong)
    if plane is None:
        return hull
    return cut_at(hull, plane.coefficients, options.sunk * pixel_size(cameras, np.zeros(3)))


def silhouette_distance(caster: RayCaster, camera: Camera) -> np.ndarray:
    """Return each pixel's signed distance [H,W] to a surface's silhouette, in pixels, positive inside."""
    return signed_distance((caster.cast(camera).depth > 0).astype(np.float32))
