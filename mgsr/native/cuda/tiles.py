"""The tiles' lists of splats, the same for both branches; their sorts and sums are torch's."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
from torch import Tensor

from mgsr.errors import GpuError
from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Int, Long, Pointer, pointer, pointers

TILE, TILE_PIXELS, BUCKET = 16, 256, 32
PAIR_FIELDS, OUTLINE_FLOATS, RECORD_FLOATS = 16, 12, 16
THREADS, SPLAT_THREADS = 256, 128
BUCKET_WARPS, BUCKET_THREADS = 2, 64
MAX_PAIRS = 2**31 - 1
SHORT_KEYS = 2**15  # tiles that keys of 16 bits tell apart
CURE = "expected fewer or smaller splats, a smaller image, or a card with more memory"
PAIR_BYTES = 450  # of a pair's lists, gradient and share of the pixels' states, at most


class TileRows(ctypes.Structure):
    """Rows of tiles, the end excluded."""

    _fields_ = (("first", Int), ("end", Int))


class Tiles(ctypes.Structure):
    """Tiles of kernels/common/tiles_cuda.h."""

    _fields_ = (
        *((name, Int) for name in ("width", "height", "across", "count")),
        ("rows", TileRows),
        *pointers("ranges", "entries", "bucket_ends"),
    )


class CountParams(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        ("width", Int),
        ("height", Int),
        ("rows", TileRows),
        *pointers("outlines", "in_all", "tile_counts"),
    )


class EmitParams(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        ("width", Int),
        ("height", Int),
        ("rows", TileRows),
        *pointers("outlines", "order", "tile_counts", "ends", "keys"),
        ("key_bytes", Int),
        ("owners", Pointer),
    )


class ListParams(ctypes.Structure):
    _fields_ = (
        ("pairs", Long),
        ("keys", Pointer),
        ("key_bytes", Int),
        *pointers("slots", "owners", "entries", "ranges"),
    )


class SumParams(ctypes.Structure):
    _fields_ = (("count", Long), *pointers("order", "tile_counts", "ends", "pairs", "sums"))


@dataclass(frozen=True)
class Band:
    """Rows of tiles of an image, first to end (excluded). tile_counts [N] int32: how many of them each splat touches;
    pairs: the sum."""

    first: int
    end: int
    tile_counts: Tensor
    pairs: int

    def struct(self) -> TileRows:
        """For the kernels' parameters."""
        return TileRows(self.first, self.end)


@dataclass(frozen=True)
class Projected:
    """A view's splats on its image. records [N,16], outlines [N,12]: see the families' kernels; order [N] int64: splats
    by depth, nearest first; whole: the band that is all of the image."""

    width: int
    height: int
    records: Tensor
    outlines: Tensor
    order: Tensor
    whole: Band


@dataclass(frozen=True)
class TileLists:
    """Which splats each tile of a band blends, nearest first.

    ends [N] int64: sums of the band's tile counts in the splats' order, each with its own; ranges [tiles,2] and
    entries [pairs,2] int32, bucket_ends [tiles] int32: see Tiles in kernels/common/tiles_cuda.h.
    """

    projected: Projected
    band: Band
    ends: Tensor
    ranges: Tensor
    entries: Tensor
    bucket_ends: Tensor

    @property
    def pairs(self) -> int:
        """How many (splat, tile) pairs there are."""
        return self.band.pairs

    @property
    def tiles(self) -> int:
        """How many tiles the band has."""
        return len(self.ranges)

    @property
    def most_buckets(self) -> int:
        """A bound on the number of buckets, which only the card knows."""
        return min(self.pairs, self.pairs // BUCKET + self.tiles)

    @property
    def bucket_blocks(self) -> int:
        """Blocks of a kernel that takes a bucket to each warp."""
        return -(-self.most_buckets // BUCKET_WARPS)

    def struct(self) -> Tiles:
        """For the kernels' parameters; its tensors must outlive the launch."""
        width, height = self.projected.width, self.projected.height
        arrays = (pointer(t) for t in (self.ranges, self.entries, self.bucket_ends))
        return Tiles(width, height, _across(width), self.tiles, self.band.struct(), *arrays)


@dataclass(frozen=True)
class Blended:
    """A band after blending. states: of its pixels at each bucket, only where a backward pass follows."""

    lists: TileLists
    states: Tensor | None
    reached: Tensor


# What every projection writes: the end of its params struct, after the splats.
PROJECTED = pointers("records", "outlines", "depths", "tile_counts", "radii")


def project(
    launcher: Launcher, family: str, params: Callable[..., ctypes.Structure], splats: Any, radii: Tensor
) -> Projected:
    """Run a family's projection of its splats struct into radii [N], and sort the splats by depth.

    params: the family's struct of the splats and PROJECTED. The number of pairs is read from the card, the one thing
    the host waits for in a rendering: it waits for the projection alone, while the card goes on with the sort.
    """
    count = splats.count
    records, outlines = radii.new_empty(count, RECORD_FLOATS), radii.new_empty(count, OUTLINE_FLOATS)
    depths, tile_counts = radii.new_empty(count), radii.new_empty(count, dtype=torch.int32)
    arrays = (pointer(t) for t in (records, outlines, depths, tile_counts, radii))
    launcher.launch(family, f"{family}_project", splat_blocks(count), SPLAT_THREADS, params(splats, *arrays))
    total = read_later(tile_counts.sum(dtype=torch.int64))
    order = torch.sort(depths, stable=True).indices
    whole = Band(0, -(-splats.height // TILE), tile_counts, total())
    return Projected(splats.width, splats.height, records, outlines, order, whole)


@cache
def most_pairs(device: torch.device) -> int:
    """How many pairs a band may have: what half of the device's memory holds."""
    if device.type != "cuda":
        return MAX_PAIRS
    return min(MAX_PAIRS, torch.cuda.get_device_properties(device).total_memory // 2 // PAIR_BYTES)


def cut_into_bands(launcher: Launcher, projected: Projected) -> list[Band]:
    """The image as bands of `most_pairs` at most, in their order: one, unless there are too many pairs for that. Then
    rows are halved until they fit, and for each part its count is waited for. A band's pixels and gradients don't
    depend on the others. Raises GpuError where a single row of tiles has too many."""
    return list(_halved(launcher, projected, projected.whole, most_pairs(projected.records.device)))


def splat_blocks(splats: int) -> int:
    """Blocks of SPLAT_THREADS, a thread a splat."""
    return -(-splats // SPLAT_THREADS)


def list_tiles(launcher: Launcher, projected: Projected, band: Band) -> TileLists:
    """List the splats for each tile of a band. Raises GpuError when memory does not hold the lists."""
    ends = torch.cumsum(band.tile_counts[projected.order], 0, dtype=torch.int64)
    with refusing(band.pairs):
        entries, ranges = _fill_lists(launcher, projected, band, ends)
    buckets = (ranges[:, 1] - ranges[:, 0] + (BUCKET - 1)) // BUCKET
    bucket_ends = torch.cumsum(buckets, 0, dtype=torch.int32)
    return TileLists(projected, band, ends, ranges, entries, bucket_ends)


def sum_pairs(launcher: Launcher, lists: TileLists, pair_gradients: Tensor) -> Tensor:
    """Sums [N,16] of the pairs' gradients [pairs,16] over each splat's tiles in the band, in a fixed order."""
    order = lists.projected.order
    sums = pair_gradients.new_empty(len(order), PAIR_FIELDS)
    arrays = (order, lists.band.tile_counts, lists.ends, pair_gradients, sums)
    params = SumParams(len(order), *(pointer(t) for t in arrays))
    launcher.launch("tiles", "tiles_sum", -(-len(order) * PAIR_FIELDS // THREADS), THREADS, params)
    return sums


def add_up(of_bands: Iterator[Tensor]) -> Tensor:
    """The sums of all bands [N,16], from each one's, in their order. One band at a time is asked for."""
    total = next(of_bands)
    for sums in of_bands:
        total += sums
    return total


@contextmanager
def refusing(pairs: int) -> Iterator[None]:
    """Within the block, too little memory is a GpuError that says why."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise GpuError(
            f"the card's memory does not hold {pairs} pairs of splats and tiles ({error}): {CURE}"
        ) from error


def read_later(scalar: Tensor) -> Callable[[], int]:
    """Starts to bring one integer to the host; the result waits for it, and for nothing launched afterwards."""
    if not scalar.is_cuda:
        return lambda: int(scalar)
    held = torch.empty((), dtype=scalar.dtype, pin_memory=True).copy_(scalar, non_blocking=True)
    arrived = torch.cuda.Event()
    arrived.record(torch.cuda.current_stream(scalar.device))

    def wait() -> int:
        arrived.synchronize()
        return int(held)

    return wait


def _halved(launcher: Launcher, projected: Projected, band: Band, most: int) -> Iterator[Band]:
    if band.pairs <= most:
        yield band
        return
    if band.end - band.first == 1:
        raise GpuError(
            f"a row of tiles of this view has {band.pairs} pairs of splats and tiles, and memory is for {most}: {CURE}"
        )
    middle = (band.first + band.end) // 2
    for first, end in ((band.first, middle), (middle, band.end)):
        yield from _halved(launcher, projected, _counted(launcher, projected, first, end), most)


def _counted(launcher: Launcher, projected: Projected, first: int, end: int) -> Band:
    in_all = projected.whole.tile_counts
    tile_counts = torch.empty_like(in_all)
    arrays = (pointer(t) for t in (projected.outlines, in_all, tile_counts))
    params = CountParams(len(in_all), projected.width, projected.height, TileRows(first, end), *arrays)
    launcher.launch("tiles", "tiles_count", -(-len(in_all) // THREADS), THREADS, params)
    return Band(first, end, tile_counts, int(tile_counts.sum(dtype=torch.int64)))


def _fill_lists(launcher: Launcher, projected: Projected, band: Band, ends: Tensor) -> tuple[Tensor, Tensor]:
    order, pairs, tiles = projected.order, band.pairs, (band.end - band.first) * _across(projected.width)
    # Short keys: the sort's time grows with their bits.
    keys = order.new_empty(pairs, dtype=torch.int16 if tiles <= SHORT_KEYS else torch.int32)
    owners = order.new_empty(pairs, dtype=torch.int32)
    arrays = (pointer(t) for t in (projected.outlines, order, band.tile_counts, ends, keys))
    size = (projected.width, projected.height, band.struct())
    emit = EmitParams(len(order), *size, *arrays, keys.element_size(), pointer(owners))
    launcher.launch("tiles", "tiles_emit", -(-len(order) // THREADS), THREADS, emit)
    keys, slots = torch.sort(keys, stable=True)
    entries, ranges = owners.new_empty(pairs, 2), owners.new_zeros(tiles, 2)
    arrays = (pointer(t) for t in (slots, owners, entries, ranges))
    listed = ListParams(pairs, pointer(keys), keys.element_size(), *arrays)
    launcher.launch("tiles", "tiles_list", -(-pairs // THREADS), THREADS, listed)
    return entries, ranges


def _across(width: int) -> int:
    """Tiles in a row."""
    return -(-width // TILE)
