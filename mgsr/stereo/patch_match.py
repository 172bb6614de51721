"""PatchMatch stereo inside the masks: depth maps, and what other views confirm of them.

Each photograph is matched with its neighbours on slanted planes by normalised cross-correlation (Bleyer and others
2011; Schönberger and others 2016, whose checks between the views these are). The search begins on a surface that is
known roughly, such as the visual hull, and prefers it where the photographs tell no more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.images import reduce_area
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.native import _stereo
from mgsr.parallel import map_ahead
from mgsr.stereo.photographs import StereoPhotographs

NEIGHBOURS = 8  # views that each is matched with
HALF_DEPTH = 1.1  # world units before and behind the scene's centre that are searched
CHECKED = 12  # views, the nearest, that may confirm a depth
CONFIRMED = 2  # of them that must
SAME = 2.0  # pixels by which depths of the same place may differ
SEEN_THROUGH = 4.0  # pixels behind a place from which a view that sees so far contradicts it
SAME_NORMAL = np.cos(np.radians(40.0))
WORTHLESS, PERFECT = 0.2, 0.8  # scores between which a depth's weight rises from LEAST to 1
LEAST = 0.05


@dataclass(frozen=True)
class MatchSettings:
    """How planes are compared and searched; the fields of StereoSettings in kernels/stereo/stereo.h, in its order.

    radius: samples of a patch on each side of its middle; spacing: pixels between them; noise: deviation, sRGB;
    alike: sRGB by which samples differ from the middle's that weigh 0.6, and reach: pixels at which they do; best:
    neighbours whose mean correlation is the score; cover: the least share of a patch that shows the object in a
    neighbour; prior: what a depth that is prior_reach pixels off the start loses in score; search: pixels by which
    depths are varied in the first of the rounds.
    """

    radius: int = 2
    spacing: float = 1.25
    noise: float = 0.012
    alike: float = 0.3
    reach: float = 4.0
    best: int = 3
    cover: float = 0.6
    prior: float = 0.1
    prior_reach: float = 3.5
    search: float = 7.0
    rounds: int = 3


@dataclass(frozen=True)
class DepthMap:
    """A depth map with normals and scores.

    depth [h,w] float32 camera z, 0 where nothing is found; normal [h,w,3] float32, unit, world frame, towards the
    camera; score [h,w] float32, the correlation with the neighbours that agree best, -1 where nothing is found.
    """

    depth: np.ndarray
    normal: np.ndarray
    score: np.ndarray


def match_views(
    photographs: StereoPhotographs,
    start: RayCaster,
    seed: int,
    settings: MatchSettings = MatchSettings(),
    progress: Callable[[float], None] = lambda done: None,
) -> list[DepthMap]:
    """Find each view's depth map, in the order of the photographs. The same seed gives the same maps.

    start: the surface where the search begins; progress: told of the share of the views that are done, 0..1.
    """
    maps = []
    for view in range(len(photographs.images)):
        maps.append(_match(photographs, view, start, seed, settings))
        progress(len(maps) / len(photographs.images))
    return maps


def _match(photographs: StereoPhotographs, view: int, start: RayCaster, seed: int, settings: MatchSettings) -> DepthMap:
    camera = photographs.cameras[view]
    size = camera.height, camera.width
    depth, normal, score = (np.zeros(shape, np.float32) for shape in (size, (*size, 3), size))
    neighbours = photographs.neighbours(view, NEIGHBOURS)
    if len(neighbours) < 2:
        return DepthMap(depth, normal, np.full_like(depth, -1))
    seen = start.cast(camera)
    turn = camera.cam_from_world[:3, :3]
    _stereo.search(
        photographs.images,
        photographs.packed_cameras,
        view,
        neighbours,
        np.ascontiguousarray(seen.depth, np.float32),
        np.ascontiguousarray(seen.normal @ turn.T, np.float32),
        search_range(camera),
        [float(each) for each in astuple(settings)],
        (seed * 1_000_003 + view) % 2**32,
        depth,
        normal,
        score,
    )
    return DepthMap(depth, (normal @ turn).astype(np.float32), score)


def search_range(camera: Camera) -> tuple[float, float]:
    """Return the least and the largest camera z at which a surface may lie."""
    middle = float(camera.cam_from_world[2, 3])
    nearest = max(middle - HALF_DEPTH, 0.05 * abs(middle), 1e-3)
    return nearest, max(middle + HALF_DEPTH, 2 * nearest)


def weigh(photographs: StereoPhotographs, maps: Sequence[DepthMap]) -> list[np.ndarray]:
    """Weigh each pixel of the depth maps, [h,w] float32 in 0..1, by how far other views confirm it.

    A pixel weighs 0 unless at least CONFIRMED views confirm it, and more confirm than contradict it. What is seen
    head-on and correlates well weighs more.
    """
    return list(map_ahead(lambda view: _weights(photographs, maps, view), range(len(maps)), None))


def weigh_gaps(coarse: Sequence[np.ndarray], fine: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Weigh coarser maps' pixels by the share of their area in which finer maps of the same views hold nothing.

    coarse: weights [h,w] of the coarser maps' pixels; fine: those of the finer maps.
    """
    return [
        weights * (1 - reduce_area((finer > 0)[..., None].astype(np.float32), *weights.shape[::-1])[..., 0])
        for weights, finer in zip(coarse, fine, strict=True)
    ]


def _weights(photographs: StereoPhotographs, maps: Sequence[DepthMap], view: int) -> np.ndarray:
    camera, found = photographs.cameras[view], maps[view]
    rays = pixel_rays(camera)
    rows, columns = np.nonzero(found.depth)
    ways = rays[rows, columns]
    normals = found.normal[rows, columns]
    points = camera.center + ways * found.depth[rows, columns, None]
    confirming, against = np.zeros(len(points), int), np.zeros(len(points), int)
    for other in photographs.neighbours(view, CHECKED, apart=0.0):
        there, its = photographs.cameras[other], maps[other]
        inside, pixels, depths = there.project_inside(points)
        across, down = pixels.astype(int).T
        gaps = (its.depth[down, across] / depths - 1) * there.K[0, 0]
        known = its.depth[down, across] > 0
        alike = (its.normal[down, across] * normals[inside]).sum(1) > SAME_NORMAL
        confirming[inside] += known & alike & (np.abs(gaps) < SAME)
        against[inside] += known & (gaps > SEEN_THROUGH)
    cosines = -(ways * normals).sum(1) / np.linalg.norm(ways, axis=1)
    scores = (found.score[rows, columns] - WORTHLESS) / (PERFECT - WORTHLESS)
    weights = np.zeros(found.depth.shape, np.float32)
    believed = (confirming >= CONFIRMED) & (confirming > against)
    weights[rows, columns] = believed * np.clip(scores, LEAST, 1) * np.clip(cosines, 0.1, 1)
    return weights
