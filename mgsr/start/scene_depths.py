"""Depth maps of everything in view, for scenes without masks, by PatchMatch stereo from coarse to fine.

The search begins on small photographs. A patch covers more of the scene there, so even plaster has some contrast. The
confirmed depths start the search on larger photographs, which finds details and more exact depths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config.expert import SceneStereoOptions, StereoConfig
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.stereo.patch_match import DepthMap, Planes, match_from, weigh
from mgsr.stereo.photographs import StereoPhotographs, stereo_photographs


@dataclass(frozen=True)
class DepthMaps:
    """The depth maps of photographs.

    cameras: the photographs' cameras. maps: a depth map for each photograph. confidence [h,w], for each map: 0..1, 0
    where other views do not confirm the depth.
    """

    cameras: list[Camera]
    maps: list[DepthMap]
    confidence: list[np.ndarray]

    def seen_from(self, cameras: Sequence[Camera]) -> DepthMaps:
        """Return the same depths as seen from other poses of the photographs' cameras."""
        placed = [
            replace(camera, cam_from_world=other.cam_from_world)
            for camera, other in zip(self.cameras, cameras, strict=True)
        ]
        return replace(self, cameras=placed)

    def known(self, view: int, camera: Camera) -> np.ndarray:
        """Return a view's confirmed depths [H,W] float32 at the size of a camera's photograph, 0 where unknown."""
        return self.planes(view, camera)[0]

    def planes(self, view: int, camera: Camera) -> Planes:
        """Return a view's confirmed planes at the size of a camera's photograph; depth is 0 where unknown."""
        found = self.maps[view]
        rows = (np.arange(camera.height) + 0.5) * found.depth.shape[0] / camera.height
        columns = (np.arange(camera.width) + 0.5) * found.depth.shape[1] / camera.width
        nearest = np.ix_(rows.astype(int), columns.astype(int))
        return np.where(self.confidence[view] > 0, found.depth, np.float32(0))[nearest], found.normal[nearest]


def scene_depths(
    views: Sequence[View],
    seed: int,
    progress: Callable[[float], None] = lambda done: None,
    options: SceneStereoOptions = SceneStereoOptions(),
    stereo: StereoConfig = StereoConfig(),
) -> DepthMaps:
    """Find the depth maps of some of a scene's views, whatever their masks.

    The same seed gives the same maps. Correlation ignores exposure, so photographs of another exposure have nearly the
    same maps. progress: receives the share of the work that is done, 0..1. stereo: the settings shared with the stereo
    of masked objects.
    """
    fine = scene_photographs(views, options)
    coarse = fine.reduced(options.coarser)
    work = options.coarser**2 * options.rounds, options.fine_rounds
    share = work[0] / max(1, sum(work))  # of the work, for the smaller photographs
    settings = replace(stereo.match.settings, noise=options.noise)
    consistency = replace(stereo.consistency, max_angle=options.max_angle, views=options.confirming_views)
    between = options.nearest, options.farthest

    def search(
        photographs: StereoPhotographs, start: Callable[[int], Planes], rounds: int, begin: float, end: float
    ) -> DepthMaps:
        match = replace(stereo.match, max_angle=options.max_angle, settings=replace(settings, rounds=rounds))
        ranges = [between] * len(photographs.cameras)
        maps = match_from(photographs, start, ranges, seed, match, lambda done: progress(begin + (end - begin) * done))
        return DepthMaps(photographs.cameras, maps, weigh(photographs, maps, consistency))

    def unknown(view: int) -> Planes:
        size = coarse.images[view].shape[:2]
        return np.zeros(size), np.zeros((*size, 3))

    first = search(coarse, unknown, options.rounds, 0.0, share)
    return search(fine, lambda view: first.planes(view, fine.cameras[view]), options.fine_rounds, share, 1.0)


def scene_photographs(views: Sequence[View], options: SceneStereoOptions) -> StereoPhotographs:
    """Prepare the photographs for stereo, without masks."""
    return stereo_photographs([replace(view, alpha=None) for view in views], options.max_pixels)
