"""Plane-sweep stereo (Collins 1996): starting points for scenes without masks.

A photograph's neighbours are warped onto a series of planes in front of it. A pixel takes the depth at which the
normalised cross-correlation (NCC) of a small window is best. Depths that other photographs do not confirm are dropped.
Regions without contrast continue the depth around them, if other photographs confirm that too. The planes are dense in
the unit ball and sparse behind it, so that background is not mistaken for a surface in the ball.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as functional
from scipy.spatial import cKDTree
from torch import Tensor

from mgsr.config.expert import PlaneSweepOptions
from mgsr.data.camera import Camera
from mgsr.data.images import reduce_area
from mgsr.data.scene import PointCloud, View
from mgsr.data.valid_mask import filled, valid_mean
from mgsr.parallel import map_ahead, one_torch_thread
from mgsr.start.depth_filling import fill_depth
from mgsr.stereo.photographs import neighbours

SWEPT = 0.65  # progress at which the planes are swept, measured as a share of the time with 62 views


def sweep_planes(
    views: Sequence[View],
    progress: Callable[[float], None] = lambda done: None,
    options: PlaneSweepOptions = PlaneSweepOptions(),
) -> PointCloud:
    """Find coloured points of the surfaces in and behind the unit ball, in the scene's frame; maybe none.

    progress: receives the share of the work that is done, 0..1.
    """
    looks = [_swept_view(view, options.side) for view in views]
    maps = []
    with one_torch_thread():
        for found in map_ahead(lambda index: _depth_map(looks, index, options), range(len(looks)), None):
            maps.append(found)
            progress(SWEPT * len(maps) / len(looks))
    maps = [_confirmed(index, looks, maps, options.confirmed, options) for index in range(len(looks))]
    whole = []
    for continued in map_ahead(lambda index: _continued(looks[index], maps[index], options), range(len(looks)), None):
        whole.append(continued)
        progress(SWEPT + (1 - SWEPT) * len(whole) / len(looks))
    cloud = _cloud(looks, maps)
    cloud = cloud.rows(_thinned(cloud.positions, options.spacing, options))
    return cloud.joined(_filled(looks, whole, cloud.positions, options))


@dataclass(frozen=True)
class _SweptView:
    """A view reduced for the sweep.

    camera: of the reduced size. image [h,w,3] sRGB 0..255. grey [1,h,w] 0..1. valid_mask [h,w] float32: 1 at valid
    pixels, else 0; None if all are valid.
    """

    camera: Camera
    image: np.ndarray
    grey: Tensor
    valid_mask: Tensor | None


def _swept_view(view: View, side: int) -> _SweptView:
    camera, image, valid_mask = view.camera, view.image.astype(np.float32), view.valid_mask
    shrink = side / max(camera.width, camera.height)
    if shrink < 1:
        camera = camera.scaled(shrink)
        size = (camera.width, camera.height)
        image, valid_mask = valid_mean(image, valid_mask, lambda pixels: reduce_area(pixels, *size))
    image = filled(image, valid_mask)
    shown = None if valid_mask is None else torch.from_numpy(valid_mask.astype(np.float32))
    return _SweptView(camera, image, torch.from_numpy(image.mean(axis=-1)[None] / 255), shown)


def _depth_map(looks: Sequence[_SweptView], index: int, options: PlaneSweepOptions) -> np.ndarray:
    """Return the depth map [h,w] of one view, camera z; infinite where the neighbours do not agree."""
    look = looks[index]
    cameras = [each.camera for each in looks]
    beside = neighbours(cameras, index, options.neighbours, options.best_angle, options.max_angle)
    nearest, farthest = (look.camera.cam_from_world[2, 3] + shift for shift in (-options.reach, options.reach))
    unknown = np.full(look.grey.shape[1:], np.inf)
    if farthest <= 0 or len(beside) < 2:
        return unknown
    nearest = max(nearest, 0.05 * farthest)
    behind = torch.linspace(0, 1 / farthest, options.planes_behind + 1)[:-1]
    inverse = torch.cat([behind, torch.linspace(1 / farthest, 1 / nearest, options.planes)])
    scores = torch.stack([_correlations(look, looks[other], inverse, options) for other in beside])
    # The better half of the neighbours only, as the others may not see the place.
    agreement = scores.topk(max(2, len(beside) // 2), dim=0).values.mean(dim=0)
    plane, clear = _best_plane(agreement, options)
    depth = 1 / np.interp(plane.numpy(), np.arange(len(inverse)), inverse.numpy()).clip(1e-6)
    return np.where(clear.numpy() & (_own_contrast(look.image, options) > options.own_contrast), depth, unknown)


def _correlations(look: _SweptView, other: _SweptView, inverse: Tensor, options: PlaneSweepOptions) -> Tensor:
    """Return the NCC [D,h,w] of `other` with `look`, warped by planes at inverse depths [D]; -1 where unseen."""
    camera, neighbour = look.camera, other.camera
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(x - camera.K[0, 2]) / camera.K[0, 0], (y - camera.K[1, 2]) / camera.K[1, 1], np.ones_like(x)], -1)
    pose = neighbour.cam_from_world @ np.linalg.inv(camera.cam_from_world)
    turned = torch.from_numpy(rays @ (neighbour.K @ pose[:3, :3]).T).float()
    moved = torch.from_numpy(neighbour.K @ pose[:3, 3]).float()
    places = turned + inverse[:, None, None, None] * moved
    places = places[..., :2] / places[..., 2:].clamp(min=1e-6)
    places = places / torch.tensor([neighbour.width, neighbour.height]) * 2 - 1
    seen = functional.grid_sample(
        other.grey[None].expand(len(inverse), -1, -1, -1), places, padding_mode="border", align_corners=False
    )[:, 0]
    own, window, noise = look.grey, options.window, options.noise
    mean, seen_mean = _window_mean(own, window), _window_mean(seen, window)
    variance = _window_mean(own * own, window) - mean * mean + noise**2
    seen_variance = _window_mean(seen * seen, window) - seen_mean * seen_mean + noise**2
    correlation = (_window_mean(seen * own, window) - seen_mean * mean) / (variance * seen_variance).clamp(
        min=1e-12
    ).sqrt()
    compared = (places.abs() < 1).all(dim=-1)
    if look.valid_mask is not None:
        compared &= look.valid_mask > 0
    if other.valid_mask is not None:
        shown = functional.grid_sample(
            other.valid_mask[None, None].expand(len(inverse), -1, -1, -1), places, mode="nearest", align_corners=False
        )
        compared &= shown[:, 0] > 0
    return torch.where(compared, correlation, -1.0)


def _window_mean(images: Tensor, window: int) -> Tensor:
    """Return the mean [N,h,w] of images [N,h,w] over a window around each pixel; window: pixels along its side."""
    half = window // 2
    padded = functional.pad(images[None], (half,) * 4, mode="replicate")[0]
    height, width = images.shape[1:]
    rows = sum(padded[:, shift : shift + height] for shift in range(window))
    assert isinstance(rows, Tensor)
    columns = sum(rows[:, :, shift : shift + width] for shift in range(window))
    assert isinstance(columns, Tensor)
    return columns / window**2


def _own_contrast(image: np.ndarray, options: PlaneSweepOptions) -> np.ndarray:
    """Return the contrast [h,w] around each pixel of an image [h,w,3], among pixels of a similar colour.

    image: sRGB 0..255. The contrast is the standard deviation, 0..1, in the channel with the largest. In a window of
    plain background beside a near object's edge, all contrast belongs to the edge, and the depth would too. Similar
    colours exclude that edge.
    """
    image = image / 255
    height, width = image.shape[:2]
    half = options.window // 2
    padded = np.pad(image, ((half, half), (half, half), (0, 0)), mode="edge")
    sums = np.zeros((3, *image.shape))  # of the weights, the weighted colours, and the weighted squares
    for top in range(options.window):
        for left in range(options.window):
            other = padded[top : top + height, left : left + width]
            alike = np.exp(-((np.abs(other - image).max(axis=2, keepdims=True) / options.similar) ** 2))
            sums += np.stack([np.broadcast_to(alike, image.shape), alike * other, alike * other * other])
    mean = sums[1] / sums[0]
    contrast: np.ndarray = np.sqrt(np.maximum(sums[2] / sums[0] - mean * mean, 0)).max(axis=2)
    return contrast


def _best_plane(agreement: Tensor, options: PlaneSweepOptions) -> tuple[Tensor, Tensor]:
    """Return each pixel's plane of best agreement [D,h,w], as an index [h,w] with a fraction from a parabola.

    Also returns where it is a clear maximum, [h,w] bool.
    """
    best, at = agreement.max(dim=0)
    count = len(agreement)
    planes = torch.arange(count)[:, None, None]
    rival = torch.where((planes - at).abs() > options.beside, agreement, -1.0).amax(dim=0)
    clear = (at > 0) & (at < count - 1) & (best > options.agreement) & (best - rival > options.lead)
    middle = at.clamp(1, count - 2)[None]
    before, here, after = (agreement.gather(0, middle + step)[0] for step in (-1, 0, 1))
    step = (after - before) / (2 * (2 * here - before - after)).clamp(min=1e-6)
    return middle[0] + step.clamp(-0.5, 0.5), clear


def _confirmed(
    index: int, looks: Sequence[_SweptView], maps: Sequence[np.ndarray], least: int, options: PlaneSweepOptions
) -> np.ndarray:
    """Drop the depths of a view that too few other views confirm.

    maps [h,w]: every view's depth map, camera z, infinite where unknown. A depth stays if at least `least` other maps
    confirm it, and more confirm it than see through it. Returns the view's depth map [h,w], infinite elsewhere.
    """
    depth = maps[index]
    positions = _positions(looks[index].camera, depth)
    confirming, against = np.zeros(len(positions), int), np.zeros(len(positions), int)
    for other, (look, found) in enumerate(zip(looks, maps, strict=True)):
        if other == index:
            continue
        at, places, depths = look.camera.project_inside(positions)
        across, down = places.astype(int).T
        gaps = found[down, across] / depths - 1
        confirming[at] += np.abs(gaps) < options.tolerance
        against[at] += np.isfinite(gaps) & (gaps > 2 * options.tolerance)
    near = np.linalg.norm(positions, axis=1) < options.max_distance
    good = (confirming >= least) & (confirming > against) & near
    kept = np.full_like(depth, np.inf)
    kept[np.isfinite(depth)] = np.where(good, depth[np.isfinite(depth)], np.inf)
    return kept


def _filled(
    looks: Sequence[_SweptView], whole: Sequence[np.ndarray], found: np.ndarray, options: PlaneSweepOptions
) -> PointCloud:
    """Return points of the filled depth maps that lie apart from the points already found.

    whole [h,w]: each view's filled depth map, camera z. found [P,3]: points in the scene's frame.
    """
    least, spacing = options.confirmed_filled, options.spacing_filled
    cloud = _cloud(looks, [_confirmed(index, looks, whole, least, options) for index in range(len(looks))])
    cloud = cloud.rows(_thinned(cloud.positions, spacing, options))
    if not len(found):
        return cloud
    return cloud.rows(cKDTree(_drawn_in(found)).query(_drawn_in(cloud.positions))[0] > spacing)


def _continued(look: _SweptView, depth: np.ndarray, options: PlaneSweepOptions) -> np.ndarray:
    """Fill the gaps in a depth map [h,w], camera z, by `fill_depth`; it stays infinite where depth is unknown."""
    inverse = fill_depth(1 / depth, look.image, options.filling)
    there = np.isfinite(inverse) if look.valid_mask is None else np.isfinite(inverse) & (look.valid_mask.numpy() > 0)
    return np.where(there, 1 / inverse, np.inf)


def _cloud(looks: Sequence[_SweptView], maps: Sequence[np.ndarray]) -> PointCloud:
    """Return the points of all views' depth maps [h,w], view by view, with their pixels' colours."""
    positions = [_positions(look.camera, depth) for look, depth in zip(looks, maps, strict=True)]
    colors = [look.image[np.isfinite(depth)] for look, depth in zip(looks, maps, strict=True)]
    return PointCloud(np.concatenate(positions), np.concatenate(colors).round().clip(0, 255).astype(np.uint8))


def _positions(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Back-project the finite pixels of a depth map [h,w], row by row, to points [P,3] in the world frame."""
    rows, columns = np.nonzero(np.isfinite(depth))
    pixels = np.stack([columns, rows], axis=1) + 0.5
    local = np.concatenate([(pixels - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]], np.ones((len(rows), 1))], axis=1)
    positions: np.ndarray = local * depth[rows, columns, None] - camera.cam_from_world[:3, 3]
    in_world: np.ndarray = positions @ camera.cam_from_world[:3, :3]
    return in_world


def _thinned(positions: np.ndarray, spacing: float, options: PlaneSweepOptions) -> np.ndarray:
    """Thin points [P,3] to one for each cell of size `spacing`, without outliers; return the indices [Q] to keep."""
    near = _drawn_in(positions)
    _, first = np.unique(np.floor(near / spacing).astype(int), axis=0, return_index=True)
    first.sort()
    if len(first) <= options.crowd:
        return first
    distances = cKDTree(near[first]).query(near[first], k=options.crowd + 1)[0][:, 1:].mean(axis=1)
    kept: np.ndarray = first[distances <= distances.mean() + options.lonely * distances.std()]
    return kept


def _drawn_in(positions: np.ndarray) -> np.ndarray:
    """Contract points [P,3] outside the unit ball into a ball of radius 2, with infinity on its surface.

    Photographs taken around the ball resolve distant places less finely.
    """
    radius = np.maximum(np.linalg.norm(positions, axis=1, keepdims=True), 1)
    drawn: np.ndarray = positions * (2 - 1 / radius) / radius
    return drawn
