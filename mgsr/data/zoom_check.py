"""Detect photographs of a COLMAP model that do not fit the lens that they share with others."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from mgsr.config.expert import ZoomCheckOptions


def zoom_note(colmap: Any, model: Any, options: ZoomCheckOptions = ZoomCheckOptions()) -> tuple[str, ...]:
    """Return a note if several photographs that share a lens in a model would each need another focal length.

    model: a pycolmap.Reconstruction; its points are held fixed. Zoomed or cropped photographs are of this kind.
    """
    placed = [image for image in model.images.values() if image.has_pose]
    sharing = Counter(image.camera_id for image in placed)
    ratios = [
        _focal_ratio(colmap, model, image, options.min_points) for image in placed if sharing[image.camera_id] > 1
    ]
    off = sum(abs(ratio - 1) > options.max_change for ratio in ratios)
    if off < max(options.min_photographs, options.min_share * len(ratios)):
        return ()
    return (
        f"{off} of {len(ratios)} photographs do not fit the lens that they share with others; if you zoomed or "
        "cropped them, the cameras are wrong, so find them again with `--set camera_per_image=on`",
    )


def _focal_ratio(colmap: Any, model: Any, image: Any, min_points: int) -> float:
    """Return the focal length fitted to a photograph alone, divided by its lens's.

    It is 1 where it can't be estimated: with fewer than `min_points` points, or where COLMAP finds none.
    """
    seen = [point for point in image.points2D if point.has_point3D()]
    if len(seen) < min_points:
        return 1.0
    pixels = np.array([point.xy for point in seen])
    places = np.array([model.points3D[point.point3D_id].xyz for point in seen])
    refinement = colmap.AbsolutePoseRefinementOptions(refine_focal_length=True, refine_extra_params=False)
    camera = colmap.Camera(image.camera.todict())  # it is changed in place
    everything = np.ones(len(seen), dtype=bool)
    refined = colmap.refine_absolute_pose(image.cam_from_world(), pixels, places, everything, camera, refinement)
    return 1.0 if refined is None else float(camera.focal_length / image.camera.focal_length)
