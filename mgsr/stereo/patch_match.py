"""PatchMatch stereo inside the masks: depth maps, and their confirmation by other views.

Each photograph is matched with its neighbours on slanted planes by normalised cross-correlation (Bleyer and others
2011). Geometric consistency between the views follows Schönberger and others 2016. The search starts on an approximate
surface, such as the visual hull, and prefers it where the photographs are ambiguous.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from mgsr.config.expert import ConsistencyOptions, MatchSettings, PatchMatchOptions
from mgsr.data.camera import Camera
from mgsr.data.images import reduce_area
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.geometry.vectors import dots, lengths
from mgsr.native import _stereo
from mgsr.native.structs import StereoPlanes, StereoSettings, StereoViews
from mgsr.parallel import map_ahead
from mgsr.stereo.photographs import StereoPhotographs

# A plane at each pixel of a view: depth [h,w], camera z, 0 where unknown; unit normal [h,w,3] in the world frame.
NEAREST = 0.05  # least camera z of the search, in distances of the scene's centre
LEAST_COSINE = 0.1  # least weight of a depth by the tilt of its surface

Planes = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class DepthMap:
    """A depth map with normals and scores.

    depth [h,w] float32: camera z, 0 where unknown. normal [h,w,3] float32: unit, in the world frame, towards the
    camera. score [h,w] float32: the mean NCC with the neighbours that agree best, -1 where unknown.
    """

    depth: np.ndarray
    normal: np.ndarray
    score: np.ndarray


def match_views(
    photographs: StereoPhotographs,
    start: RayCaster,
    seed: int,
    options: PatchMatchOptions = PatchMatchOptions(),
    progress: Callable[[float], None] = lambda done: None,
) -> list[DepthMap]:
    """Find each view's depth map, in the order of the photographs. The same seed gives the same maps.

    start: the surface on which the search begins. progress: receives the share of the views that are done, 0..1.
    """

    def seen(view: int) -> Planes:
        hits = start.cast(photographs.cameras[view])
        return hits.depth, hits.normal

    ranges = [search_range(camera, options.half_depth) for camera in photographs.cameras]
    return match_from(photographs, seen, ranges, seed, options, progress)


def match_from(
    photographs: StereoPhotographs,
    start: Callable[[int], Planes],
    ranges: Sequence[tuple[float, float]],
    seed: int,
    options: PatchMatchOptions = PatchMatchOptions(),
    progress: Callable[[float], None] = lambda done: None,
) -> list[DepthMap]:
    """Find each view's depth map from the planes at which its search starts; otherwise as `match_views`.

    start: returns the planes of a view, given its index. ranges: each view's least and largest camera z, in world
    units.
    """
    maps = []
    for view, between in enumerate(ranges):
        maps.append(_match(photographs, view, start(view), between, seed, options))
        progress(len(maps) / len(ranges))
    return maps


def _match(
    photographs: StereoPhotographs,
    view: int,
    start: Planes,
    between: tuple[float, float],
    seed: int,
    options: PatchMatchOptions,
) -> DepthMap:
    camera = photographs.cameras[view]
    size = camera.height, camera.width
    depth, normal, score = (np.zeros(shape, np.float32) for shape in (size, (*size, 3), size))
    neighbours = photographs.neighbours(view, options.neighbours, options.best_angle, options.max_angle)
    if len(neighbours) < 2:
        return DepthMap(depth, normal, np.full_like(depth, -1))
    turn = camera.cam_from_world[:3, :3]
    _stereo.search(
        views=stereo_views(photographs, view, neighbours, between),
        start=StereoPlanes(
            depth=np.ascontiguousarray(start[0], np.float32),
            normal=np.ascontiguousarray(start[1] @ turn.T, np.float32),
        ),
        settings=stereo_settings(options.settings),
        seed=(seed * 1_000_003 + view) % 2**32,
        found=StereoPlanes(depth=depth, normal=normal),
        score=score,
    )
    return DepthMap(depth, (normal @ turn).astype(np.float32), score)


def stereo_settings(settings: MatchSettings) -> StereoSettings:
    """Return the settings of the matching as the kernels take them."""
    return StereoSettings(**asdict(settings))


def stereo_views(
    photographs: StereoPhotographs, view: int, neighbours: Sequence[int], between: tuple[float, float]
) -> StereoViews:
    """Return a photograph and its neighbours as the kernels take them.

    between: the least and the largest camera z of the search, in world units.
    """
    return StereoViews(
        images=photographs.images,
        cameras=photographs.packed_cameras,
        view=view,
        neighbours=neighbours,
        range=between,
    )


def search_range(camera: Camera, half_depth: float) -> tuple[float, float]:
    """Return the least and the largest camera z of the search, in world units.

    half_depth: of the search before and behind the scene's centre, in world units.
    """
    middle = float(camera.cam_from_world[2, 3])
    nearest = max(middle - half_depth, NEAREST * abs(middle), 1e-3)
    return nearest, max(middle + half_depth, 2 * nearest)


def weigh(
    photographs: StereoPhotographs, maps: Sequence[DepthMap], options: ConsistencyOptions = ConsistencyOptions()
) -> list[np.ndarray]:
    """Return the confidence [h,w] float32 0..1 in each pixel of the depth maps.

    It is 0 unless at least `options.min_confirming` views confirm the depth, and more confirm than contradict it.
    Depths that are seen head-on and correlate well weigh more.
    """
    return list(map_ahead(lambda view: _weights(photographs, maps, view, options), range(len(maps)), None))


def weigh_gaps(coarse: Sequence[np.ndarray], fine: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Multiply coarse maps' weights by the share of each pixel's area in which the finer maps have no depth.

    coarse [h,w], fine [H,W]: the weights of the coarse and the finer maps of the same views. Returns weights [h,w].
    """
    return [
        weights * (1 - reduce_area((finer > 0)[..., None].astype(np.float32), *weights.shape[::-1])[..., 0])
        for weights, finer in zip(coarse, fine, strict=True)
    ]


def _weights(
    photographs: StereoPhotographs, maps: Sequence[DepthMap], view: int, options: ConsistencyOptions
) -> np.ndarray:
    """Return the confidence [h,w] float32 0..1 in one view's depths (`weigh`)."""
    camera, found = photographs.cameras[view], maps[view]
    rays = pixel_rays(camera)
    rows, columns = np.nonzero(found.depth)
    ways = rays[rows, columns]
    normals = found.normal[rows, columns]
    points = camera.center + ways * found.depth[rows, columns, None]
    confirming, against = np.zeros(len(points), int), np.zeros(len(points), int)
    same_normal = np.cos(np.radians(options.same_normal))
    for other in photographs.neighbours(view, options.views, 0.0, options.max_angle):
        there, its = photographs.cameras[other], maps[other]
        inside, pixels, depths = there.project_inside(points)
        across, down = pixels.astype(int).T
        gaps = (its.depth[down, across] / depths - 1) * there.K[0, 0]
        known = its.depth[down, across] > 0
        alike = dots(its.normal[down, across], normals[inside]) > same_normal
        confirming[inside] += known & alike & (np.abs(gaps) < options.same_depth)
        against[inside] += known & (gaps > options.seen_through)
    cosines = -dots(ways, normals) / lengths(ways)
    scores = (found.score[rows, columns] - options.worthless) / (options.perfect - options.worthless)
    weights = np.zeros(found.depth.shape, np.float32)
    believed = (confirming >= options.min_confirming) & (confirming > against)
    weights[rows, columns] = believed * np.clip(scores, options.least, 1) * np.clip(cosines, LEAST_COSINE, 1)
    return weights
