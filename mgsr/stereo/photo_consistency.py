"""Photo-consistency of a surface: how well the photographs agree at its points."""

from __future__ import annotations

import numpy as np

from mgsr.config.expert import PatchMatchOptions
from mgsr.geometry.raycast import RayCaster
from mgsr.native import _stereo
from mgsr.native.structs import StereoPlanes
from mgsr.stereo.patch_match import search_range, stereo_settings, stereo_views
from mgsr.stereo.photographs import StereoPhotographs


def photo_consistency(
    photographs: StereoPhotographs, surface: RayCaster, options: PatchMatchOptions = PatchMatchOptions()
) -> float:
    """Return the photo-consistency of a surface: the mean NCC, -1..1, of the photographs with their neighbours.

    Patches are warped by the surface's tangent planes. The mean is over all pixels that show the object; a pixel
    without surface counts as -1. The result is 0 if no photograph has neighbours.
    """
    total, count = 0.0, 0
    for view, camera in enumerate(photographs.cameras):
        neighbours = photographs.neighbours(view, options.neighbours, options.best_angle, options.max_angle)
        if len(neighbours) < 2:
            continue
        seen, score = surface.cast(camera), np.empty((camera.height, camera.width), np.float32)
        planes = StereoPlanes(
            depth=np.ascontiguousarray(seen.depth, np.float32),
            normal=np.ascontiguousarray(seen.normal @ camera.cam_from_world[:3, :3].T, np.float32),
        )
        views = stereo_views(photographs, view, neighbours, search_range(camera, options.half_depth))
        _stereo.judge(views, planes, stereo_settings(options.settings), score)
        shown = photographs.images[view][..., 3] > 0.5
        total, count = total + float(score[shown].sum(dtype=np.float64)), count + int(shown.sum())
    return total / max(count, 1)
