"""The lists of splats for each tile, which both branches share. Torch sorts them and makes prefix sums."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Int, Long, Pointer, addresses, pointer, pointers

TILE, TILE_PIXELS, BUCKET = 16, 256, 32
PAIR_FIELDS, OUTLINE_FLOATS, RECORD_FLOATS = 16, 12, 16
THREADS, SPLAT_THREADS, BUCKETS_THREADS = 256, 128, 1024
BUCKET_WARPS, BUCKET_THREADS = 2, 64
SHORT_KEYS = 2**15  # the number of tiles that 16-bit keys can distinguish


class TileRows(ctypes.Structure):
    """The struct TileRows: rows of tiles, the end excluded."""

    _fields_ = (("first", Int), ("end", Int))


class Tiles(ctypes.Structure):
    """The struct Tiles of kernels/common/tiles_cuda.h."""

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


class BucketsParams(ctypes.Structure):
    _fields_ = (("tiles", Int), *pointers("ranges", "bucket_ends"))


class SumParams(ctypes.Structure):
    _fields_ = (("count", Long), *pointers("order", "tile_counts", "ends", "pairs", "sums"))


@dataclass(frozen=True)
class Band:
    """A band of an image: rows of tiles from first to end (excluded).

    tile_counts [N] int32: the number of its tiles that each splat touches. pairs: the sum of these numbers.
    """

    first: int
    end: int
    tile_counts: Tensor
    pairs: int

    def struct(self) -> TileRows:
        """Return the band as a struct for the kernels' parameters."""
        return TileRows(self.first, self.end)


@dataclass(frozen=True)
class Projected:
    """A view's splats projected onto its image.

    records [N,16], outlines [N,12]: see the families' kernels.
    order [N] int64: the splats by depth, nearest first.
    whole: the band that covers the whole image.
    splats: the family's struct of the splats.
    """

    width: int
    height: int
    records: Tensor
    outlines: Tensor
    order: Tensor
    whole: Band
    splats: Any


@dataclass(slots=True)
class TileLists:
    """The splats that each tile of a band blends, nearest first.

    ends [N] int64: the inclusive sums of the band's tile counts, in the splats' order.
    tiles: the number of tiles of the band.
    ranges [tiles,2], entries [pairs,2], bucket_ends [tiles]: int32, see Tiles in kernels/common/tiles_cuda.h.
    struct: the same data for the kernels' parameters.
    """

    projected: Projected
    band: Band
    ends: Tensor
    tiles: int
    ranges: Tensor
    entries: Tensor
    bucket_ends: Tensor
    struct: Tiles

    @property
    def pairs(self) -> int:
        """Return the number of (splat, tile) pairs."""
        return self.band.pairs

    @property
    def most_buckets(self) -> int:
        """Return an upper bound of the number of buckets, which itself is known only on the GPU."""
        return min(self.pairs, self.pairs // BUCKET + self.tiles)

    @property
    def bucket_blocks(self) -> int:
        """Return the number of blocks of a kernel that runs one warp per bucket."""
        return -(-self.most_buckets // BUCKET_WARPS)


@dataclass(frozen=True)
class Blended:
    """A band after blending. states: the pixels' states at each bucket, only if a backward pass follows."""

    lists: TileLists
    states: Tensor | None
    reached: Tensor


# The outputs of every projection, which follow the splats in its params struct.
PROJECTED = pointers("records", "outlines", "depths", "tile_counts", "radii")


def project(
    launcher: Launcher, family: str, params: Callable[..., ctypes.Structure], splats: Any, radii: Tensor
) -> Projected:
    """Run a family's projection of its splats struct into radii [N], and sort the splats by depth.

    params: the family's struct of the splats and PROJECTED. The host reads only the number of pairs from the GPU. For
    this it waits for the projection, while the GPU continues with the sort.
    """
    count = splats.count
    records, outlines = radii.new_empty(count, RECORD_FLOATS), radii.new_empty(count, OUTLINE_FLOATS)
    depths, tile_counts = radii.new_empty(count), radii.new_empty(count, dtype=torch.int32)
    arrays = addresses(records, outlines, depths, tile_counts, radii)
    launcher.launch(family, f"{family}_project", splat_blocks(count), SPLAT_THREADS, params(splats, *arrays))
    total = read_later(tile_counts.sum(dtype=torch.int64))
    order = torch.sort(depths, stable=True).indices
    whole = Band(0, -(-splats.height // TILE), tile_counts, total())
    return Projected(splats.width, splats.height, records, outlines, order, whole, splats)


def splat_blocks(splats: int) -> int:
    """Return the number of blocks of SPLAT_THREADS that have a thread for each splat."""
    return -(-splats // SPLAT_THREADS)


def list_tiles(launcher: Launcher, projected: Projected, band: Band) -> TileLists:
    """List the splats for each tile of a band.

    Raises torch.OutOfMemoryError.
    """
    across = -(-projected.width // TILE)
    rows, tiles = band.struct(), (band.end - band.first) * across
    ends = torch.cumsum(band.tile_counts.index_select(0, projected.order), 0, dtype=torch.int64)
    entries, ranges = _fill_lists(launcher, projected, band, rows, tiles, ends)
    bucket_ends = ranges.new_empty(tiles)
    arrays = addresses(ranges, entries, bucket_ends)
    buckets = BucketsParams(tiles, arrays[0], arrays[2])
    launcher.launch("tiles", "tiles_buckets", 1, BUCKETS_THREADS, buckets)
    struct = Tiles(projected.width, projected.height, across, tiles, rows, *arrays)
    return TileLists(projected, band, ends, tiles, ranges, entries, bucket_ends, struct)


def sum_pairs(launcher: Launcher, lists: TileLists, pair_gradients: Tensor) -> Tensor:
    """Sum the pairs' gradients [pairs,16] over each splat's tiles in the band, in a fixed order, to [N,16]."""
    order = lists.projected.order
    sums = pair_gradients.new_empty(order.shape[0], PAIR_FIELDS)
    arrays = (order, lists.band.tile_counts, lists.ends, pair_gradients, sums)
    params = SumParams(order.shape[0], *addresses(*arrays))
    launcher.launch("tiles", "tiles_sum", -(-order.shape[0] * PAIR_FIELDS // THREADS), THREADS, params)
    return sums


def read_later(scalar: Tensor) -> Callable[[], int]:
    """Start copying an integer [] to the host, and return a function that waits for it.

    The function does not wait for later launches.
    """
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
    launcher: Launcher, projected: Projected, band: Band, rows: TileRows, tiles: int, ends: Tensor
) -> tuple[Tensor, Tensor]:
    """Return a band's entries [P,2], sorted by tile and depth, and the range of each tile in them, [T,2]."""
    order, pairs = projected.order, band.pairs
    splats = order.shape[0]
    # Short keys are faster, since the sort's time grows with their bits.
    short = tiles <= SHORT_KEYS
    keys = order.new_empty(pairs, dtype=torch.int16 if short else torch.int32)
    owners = order.new_empty(pairs, dtype=torch.int32)
    arrays = addresses(projected.outlines, order, band.tile_counts, ends, keys)
    key_bytes = 2 if short else 4
    emit = EmitParams(splats, projected.width, projected.height, rows, *arrays, key_bytes, pointer(owners))
    launcher.launch("tiles", "tiles_emit", -(-splats // THREADS), THREADS, emit)
    keys, slots = torch.sort(keys, stable=True)
    entries, ranges = owners.new_empty(pairs, 2), owners.new_zeros(tiles, 2)
    listed = ListParams(pairs, pointer(keys), key_bytes, *addresses(slots, owners, entries, ranges))
    launcher.launch("tiles", "tiles_list", -(-pairs // THREADS), THREADS, listed)
    return entries, ranges
