"""The tiles' lists of splats, the same for both branches; their sorts and sums are torch's."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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


class Tiles(ctypes.Structure):
    """Tiles of kernels/common/tiles_cuda.h."""

    _fields_ = (
        *((name, Int) for name in ("width", "height", "across", "count")),
        *pointers("ranges", "entries", "bucket_ends"),
    )


class EmitParams(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        ("width", Int),
        ("height", Int),
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
class TileLists:
    """Which splats each tile of an image blends, nearest first.

    order [N] int64: splats by depth; tile_counts [N] int32; ends [N] int64: sums of the counts in that order, each with
    its own; pairs: how many (splat, tile) pairs there are; ranges [tiles,2] and entries [pairs,2] int32, bucket_ends
    [tiles] int32: see Tiles in kernels/common/tiles_cuda.h.
    """

    width: int
    height: int
    order: Tensor
    tile_counts: Tensor
    ends: Tensor
    pairs: int
    ranges: Tensor
    entries: Tensor
    bucket_ends: Tensor

    @property
    def tiles(self) -> int:
        """How many tiles the image has."""
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
        arrays = (pointer(t) for t in (self.ranges, self.entries, self.bucket_ends))
        return Tiles(self.width, self.height, -(-self.width // TILE), self.tiles, *arrays)


# What every projection writes: the end of its params struct, after the splats.
PROJECTED = pointers("records", "outlines", "depths", "tile_counts", "radii")


def project(
    launcher: Launcher, family: str, params: Callable[..., ctypes.Structure], splats: Any, radii: Tensor
) -> tuple[Tensor, Tensor, TileLists]:
    """Run a family's projection of its splats struct into radii [N]: records, outlines and the lists of the tiles.

    params: the family's struct of the splats and PROJECTED.
    """
    count = splats.count
    records, outlines = radii.new_empty(count, RECORD_FLOATS), radii.new_empty(count, OUTLINE_FLOATS)
    depths, tile_counts = radii.new_empty(count), radii.new_empty(count, dtype=torch.int32)
    arrays = (pointer(t) for t in (records, outlines, depths, tile_counts, radii))
    launcher.launch(family, f"{family}_project", splat_blocks(count), SPLAT_THREADS, params(splats, *arrays))
    return records, outlines, list_tiles(launcher, depths, outlines, tile_counts, splats.width, splats.height)


def splat_blocks(splats: int) -> int:
    """Blocks of SPLAT_THREADS, a thread a splat."""
    return -(-splats // SPLAT_THREADS)


def list_tiles(
    launcher: Launcher, depths: Tensor, outlines: Tensor, tile_counts: Tensor, width: int, height: int
) -> TileLists:
    """Sort the splats by depth and list them for each tile.

    depths [N], outlines [N,12] and tile_counts [N] int32 as the projection left them. The number of pairs is read from
    the card, the one thing the host waits for in a rendering: it waits for the projection alone, while the card goes on
    with the sort. Raises GpuError when there are more pairs than memory, or than 2^31.
    """
    total = read_later(tile_counts.sum(dtype=torch.int64))
    order = torch.sort(depths, stable=True).indices
    ends = torch.cumsum(tile_counts[order], 0, dtype=torch.int64)
    pairs = total()
    tiles = -(-width // TILE) * -(-height // TILE)
    with refusing(pairs):
        entries, ranges = _fill_lists(launcher, outlines, order, tile_counts, ends, pairs, tiles, width, height)
    buckets = (ranges[:, 1] - ranges[:, 0] + (BUCKET - 1)) // BUCKET
    bucket_ends = torch.cumsum(buckets, 0, dtype=torch.int32)
    return TileLists(width, height, order, tile_counts, ends, pairs, ranges, entries, bucket_ends)


def sum_pairs(launcher: Launcher, lists: TileLists, pair_gradients: Tensor) -> Tensor:
    """Sums [N,16] of the pairs' gradients [pairs,16] over each splat's tiles, in a fixed order; not set for a splat
    that touches none."""
    count = len(lists.order)
    sums = pair_gradients.new_empty(count, PAIR_FIELDS)
    arrays = (lists.order, lists.tile_counts, lists.ends, pair_gradients, sums)
    params = SumParams(count, *(pointer(t) for t in arrays))
    launcher.launch("tiles", "tiles_sum", -(-count * PAIR_FIELDS // THREADS), THREADS, params)
    return sums


@contextmanager
def refusing(pairs: int) -> Iterator[None]:
    """Within the block, too little memory is a GpuError that says why; so are more than 2^31 pairs, at once."""
    cure = "expected fewer or smaller splats, a smaller image, or a card with more memory"
    if pairs > MAX_PAIRS:
        raise GpuError(f"this view has {pairs} pairs of splats and tiles, more than 2^31: {cure}")
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise GpuError(
            f"the card's memory does not hold {pairs} pairs of splats and tiles ({error}): {cure}"
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


def _fill_lists(
    launcher: Launcher,
    outlines: Tensor,
    order: Tensor,
    tile_counts: Tensor,
    ends: Tensor,
    pairs: int,
    tiles: int,
    width: int,
    height: int,
) -> tuple[Tensor, Tensor]:
    # Short keys: the sort's time grows with their bits.
    keys = order.new_empty(pairs, dtype=torch.int16 if tiles <= 2**15 else torch.int32)
    owners = order.new_empty(pairs, dtype=torch.int32)
    arrays = (pointer(t) for t in (outlines, order, tile_counts, ends, keys))
    emit = EmitParams(len(order), width, height, *arrays, keys.element_size(), pointer(owners))
    launcher.launch("tiles", "tiles_emit", -(-len(order) // THREADS), THREADS, emit)
    keys, slots = torch.sort(keys, stable=True)
    entries, ranges = owners.new_empty(pairs, 2), owners.new_zeros(tiles, 2)
    arrays = (pointer(t) for t in (slots, owners, entries, ranges))
    listed = ListParams(pairs, pointer(keys), keys.element_size(), *arrays)
    launcher.launch("tiles", "tiles_list", -(-pairs // THREADS), THREADS, listed)
    return entries, ranges
