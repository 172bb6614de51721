"""Count the steps of the rasterizers' walks over a scene's tiles, ours and gsplat's, by doing them on arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from benchmarks.rasterizers import Scene
from mgsr.native.cuda import gaussians, tiles
from mgsr.native.cuda.tiles import BUCKET, TILE, TILE_PIXELS
from mgsr.native.structs import GaussianSplats, GaussianView
from mgsr.ops.gaussians import GaussianOptions
from tests.cuda_shim.launcher import ShimLauncher

MIN_ALPHA, MAX_ALPHA, MIN_LIGHT = np.float32(1 / 255), np.float32(0.999), np.float32(1e-4)
BATCH = 256
CHUNK = 8  # splats whose pixels the backward walk sums at once
PATCH_WIDTH, PATCH_HEIGHT, PATCHES = 8, 4, 8
FARTHEST = 3.33  # standard deviations at which gsplat cuts a splat's box


@dataclass(frozen=True)
class Splats:
    """Projected splats as the records have them.

    centers [N,2] float64, roots [N,3], opacities [N,2] (transmitted, reflected: 0 for single opacity).
    """

    centers: np.ndarray
    roots: np.ndarray
    opacities: np.ndarray

    def alphas(self, chosen: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the alphas [2,splats,pixels] at those pixels' centres, 0 where a splat does not count."""
        dx = (x + 0.5 - self.centers[chosen, :1]).astype(np.float32)
        dy = (y + 0.5 - self.centers[chosen, 1:]).astype(np.float32)
        a, b, c = (self.roots[chosen, k : k + 1] for k in range(3))
        weight = np.exp2(-((a * dx + b * dy) ** 2) - (c * dy) ** 2)
        raw = self.opacities[chosen].T[:, :, None] * weight
        return np.where(raw >= MIN_ALPHA, np.minimum(raw, MAX_ALPHA), np.float32(0))


@dataclass(frozen=True)
class Lists:
    """Each tile's splats, nearest first: entries begin[tile] to begin[tile + 1]."""

    splats: np.ndarray
    begins: np.ndarray
    width: int
    height: int

    @property
    def tiles(self) -> int:
        """Return how many tiles the image has."""
        return len(self.begins) - 1

    def each(self) -> Iterator[tuple[np.ndarray, int, int]]:
        """Yield the splats of each tile that has any, and the tile's first pixel."""
        across = -(-self.width // TILE)
        for tile in np.flatnonzero(np.diff(self.begins)):
            chosen = self.splats[self.begins[tile] : self.begins[tile + 1]]
            yield chosen, int(tile % across * TILE), int(tile // across * TILE)


@dataclass(frozen=True)
class View:
    """A scene as a camera sees it. order [N]: the seen splats, nearest first."""

    splats: Splats
    lists: Lists
    order: np.ndarray


def project(scene: Scene, dual: bool) -> View:
    """Return a scene's splats and lists, as the CUDA kernels make them (on this machine's processor)."""
    launcher, options, camera = ShimLauncher(), GaussianOptions(), scene.camera
    means, quats, scales, opacities, colors = (leaf.detach() for leaf in scene.leaves)
    given = GaussianSplats(
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        colors=colors,
        refl_opacities=scene.reflected.opacities.detach() if dual else None,
        refl_colors=scene.reflected.colors.detach() if dual else None,
        weights=scene.reflected.weights.detach() if dual else None,
        background=scene.background,
    )
    view = GaussianView(camera=camera, near=options.near, low_pass=options.low_pass, compensate=options.compensate)
    struct = gaussians.splats_struct(given, view)
    projected = tiles.project(launcher, "gaussians", gaussians.GaussianProjectParams, struct, torch.empty(len(means)))
    lists = tiles.list_tiles(launcher, projected, projected.whole)
    records = projected.records.numpy()
    whole = np.ascontiguousarray(records[:, :1]).view(np.int16)
    splats = Splats(whole + records[:, 1:3].astype(np.float64), records[:, 3:6], records[:, [6, 11]])
    ranges = lists.ranges.numpy()
    begins = np.concatenate([[0], np.cumsum(ranges[:, 1] - ranges[:, 0])])
    seen = projected.whole.tile_counts[projected.order] > 0
    ours = Lists(lists.entries[:, 0].numpy(), begins, camera.width, camera.height)
    return View(splats, ours, projected.order[seen].numpy())


def gsplat_lists(view: View, opacity: int) -> Lists:
    """Return the lists that gsplat makes: all tiles of a splat's box.

    opacity: 0 transmitted, 1 reflected.
    """
    splats, order, ours = view.splats, view.order, view.lists
    a, b, c = (splats.roots[order, k].astype(np.float64) for k in range(3))
    half = np.log2(np.e) / 2  # root^T root is the inverse covariance times this
    xx, yy, xy = a * a / half, (b * b + c * c) / half, a * b / half
    det = xx * yy - xy * xy
    strong = splats.opacities[order, opacity] >= MIN_ALPHA
    reach = np.minimum(FARTHEST, np.sqrt(2 * np.log(np.maximum(splats.opacities[order, opacity] * 255, 1))))
    radius = np.ceil(reach[:, None] * np.sqrt(np.stack([yy, xx], 1) / det[:, None]))
    size = np.array([-(-ours.width // TILE), -(-ours.height // TILE)])
    low = np.clip(np.floor((splats.centers[order] - radius) / TILE), 0, size).astype(int)
    high = np.clip(np.ceil((splats.centers[order] + radius) / TILE), 0, size).astype(int)
    found: list[list[int]] = [[] for _ in range(size[0] * size[1])]
    for splat, seen, (x0, y0), (x1, y1) in zip(order.tolist(), strong, low, high, strict=True):
        for row in range(y0, y1 if seen else y0):
            for column in range(x0, x1):
                found[row * size[0] + column].append(splat)
    begins = np.concatenate([[0], np.cumsum([len(tile) for tile in found])])
    return Lists(np.array([s for tile in found for s in tile]), begins, ours.width, ours.height)


def pixels(x0: int, y0: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates of a tile's pixels, those of a warp's block of width x height side by side."""
    number = np.arange(TILE_PIXELS)
    warp, place = number // BUCKET, number % BUCKET
    blocks = TILE // width
    return x0 + warp % blocks * width + place % width, y0 + warp // blocks * height + place // width


def blend(alphas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which splats are blended [splats,pixels], and at which each pixel stops [pixels].

    A pixel that does not stop has the number of splats.
    """
    after = np.cumprod(1 - alphas.astype(np.float64), axis=0)
    stopped = after < MIN_LIGHT
    stops = np.where(stopped.any(0), stopped.argmax(0), len(alphas))
    return (alphas > 0) & (np.arange(len(alphas))[:, None] < stops), stops


def count_ours(view: View, dual: bool) -> Counter[str]:
    """Count the steps of our forward and backward walks, in a warp's turns.

    batches, buckets, steps: of forward; useful: those of its steps in which a pixel blends the splat; and of backward,
    whose steps are the same: back_buckets, back_patches (with an open pixel), back_chunks of up to CHUNK splats.
    """
    counts: Counter[str] = Counter(warps=view.lists.tiles * TILE_PIXELS // BUCKET, steps=0)
    for chosen, x0, y0 in view.lists.each():
        x, y = pixels(x0, y0, PATCH_WIDTH, PATCH_HEIGHT)
        inside = (x < view.lists.width) & (y < view.lists.height)
        alphas = view.splats.alphas(chosen, x, y)
        blended, stops = blend(alphas[0])
        if dual:
            blended_too, stops_too = blend(alphas[1])
            blended, stops = blended | blended_too, np.maximum(stops, stops_too)
        stops = np.where(inside, stops, -1).reshape(TILE_PIXELS // BUCKET, BUCKET)
        _count_tile(counts, _by_warp(blended & inside), _by_warp(alphas.max(0) > 0), stops)
    return counts


def _by_warp(of_pixels: np.ndarray) -> np.ndarray:
    return np.asarray(of_pixels.reshape(len(of_pixels), TILE_PIXELS // BUCKET, BUCKET).any(2))


def _count_tile(counts: Counter[str], blended: np.ndarray, touched: np.ndarray, stops: np.ndarray) -> None:
    """Add a tile's steps to the counts.

    blended, touched [splats,warps]; stops [warps,32].
    """
    for begin in range(0, len(touched), BATCH):
        if stops.max() < begin:  # all pixels are closed
            return
        counts["batches"] += touched.shape[1]
        for first in range(begin, min(begin + BATCH, len(touched)), BUCKET):
            open_warps = (stops >= first).any(1)
            walked = touched[first : first + BUCKET] & open_warps
            counts["buckets"] += touched.shape[1]
            counts["steps"] += int(walked.sum())
            counts["useful"] += int((blended[first : first + BUCKET] & walked).sum())
            counts["back_buckets"] += 1
            counts["back_patches"] += int((open_warps & touched[first : first + BUCKET].any(0)).sum())
            counts["back_chunks"] += int(-(-walked.sum(0) // CHUNK).sum())


def count_gsplat(view: View, opacity: int) -> Counter[str]:
    """Count the steps of gsplat's walks, in a warp's turns.

    batches, steps, useful: of forward; back_*: of backward.
    """
    lists = gsplat_lists(view, opacity)
    counts: Counter[str] = Counter(warps=lists.tiles * TILE_PIXELS // BUCKET)
    for chosen, x0, y0 in lists.each():
        x, y = pixels(x0, y0, TILE, 2)
        inside = (x < lists.width) & (y < lists.height)
        alphas = view.splats.alphas(chosen, x, y)[opacity]
        blended, stops = blend(alphas)
        blended &= inside
        length = len(chosen)
        # A pixel's last step is the splat that stops it.
        last = np.where(inside, np.minimum(stops + 1, length), 0).reshape(8, BUCKET).max(1)
        evaluated = np.arange(length)[:, None] < np.minimum(stops + 1, length)
        final = np.where(blended.any(0), length - blended[::-1].argmax(0), 0).reshape(8, BUCKET).max(1)
        batches = -(-length // BATCH)
        counts.update(steps=int(last.sum()), back_steps=int(final.sum()))
        counts["useful"] += int(_by_warp((alphas > 0) & evaluated & inside).sum())
        counts["back_useful"] += int(_by_warp(blended).sum())
        counts.update(batches=8 * min(batches, -(-int(last.max()) // BATCH)), back_batches=8 * batches)
    return counts
