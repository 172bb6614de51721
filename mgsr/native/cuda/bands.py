"""The division of an image into bands of tile rows, for images with more pairs than the GPU's memory holds.

A pair is a splat and a tile that it touches. Pixels and gradients of a band do not depend on other bands, so bands
change no result. The size of a band is estimated from the free memory. If it was too large, the band is computed again
in halves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import torch
from torch import Tensor

from mgsr.errors import GpuError
from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import addresses
from mgsr.native.cuda.tiles import THREADS, Band, Blended, CountParams, Projected, TileRows

MAX_PAIRS = 2**31 - 1  # pairs have 32-bit numbers
PAIR_BYTES = 450  # upper bound for a pair's lists, its gradient and its share of the pixels' states
FEW = 16  # the free memory is not queried if the pairs need less than 1/FEW of the GPU's memory
CURE = "use fewer or smaller splats, a smaller image or a GPU with more memory"

Result = TypeVar("Result")


@dataclass(frozen=True)
class _OutOfMemory:
    """The message of torch's error, without its traceback, which would keep the failed band's tensors."""

    reason: str


def most_pairs(device: torch.device, wanted: int) -> int:
    """Return the most pairs that a band may have; wanted: the number of pairs of the whole image.

    They fill half of the device's free memory; the other half is for the steps after a rendering. Memory that torch's
    allocator caches counts as free. The driver is asked only for an image with many pairs.
    """
    if device.type != "cuda" or wanted * PAIR_BYTES * FEW <= _total_memory(device):
        return MAX_PAIRS
    free, _ = torch.cuda.mem_get_info(device)
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return min(MAX_PAIRS, (free + kept) // 2 // PAIR_BYTES)


def cut_into_bands(launcher: Launcher, projected: Projected) -> list[Band]:
    """Cut the image into bands with at most `most_pairs` pairs each, or of one row of tiles, in their order.

    An image with few pairs is one band. Otherwise bands are halved until they fit; the host waits for each half's
    count. Raises GpuError if a single row of tiles has more than MAX_PAIRS pairs.
    """
    most = most_pairs(projected.records.device, projected.whole.pairs)
    return list(_cut(launcher, projected, projected.whole, most))


def work_bands(
    launcher: Launcher, projected: Projected, bands: list[Band], work: Callable[[Band], Result]
) -> Iterator[tuple[Band, Result]]:
    """Yield each band with the result of `work`, in their order, one at a time.

    If the memory cannot hold a band, `work` runs again on its halves. Raises GpuError if the memory cannot hold a
    single row of tiles.
    """
    waiting = bands[::-1]
    while waiting:
        band = waiting.pop()
        result = _try(work, band)
        if isinstance(result, _OutOfMemory):
            first, second = _halve(launcher, projected, band, result.reason)
            waiting += (second, first)
        else:
            yield band, result


def blend_bands(
    launcher: Launcher, projected: Projected, blend: Callable[[Band, bool], Blended], keep: bool
) -> tuple[list[Band], Blended | None]:
    """Blend an image in as few bands as memory allows, and return the bands.

    With `keep`, the blended band is returned too, if the image is one band. blend: blends a band into the images, and
    keeps the pixels' states if its second argument is True. Raises the GpuError of `work_bands`.
    """

    def blend_whole_or_part(band: Band) -> Blended | None:
        kept = keep and band is projected.whole
        blended = blend(band, kept)
        return blended if kept else None

    worked = list(work_bands(launcher, projected, cut_into_bands(launcher, projected), blend_whole_or_part))
    return [band for band, _ in worked], worked[0][1]


def add_bands(launcher: Launcher, projected: Projected, bands: list[Band], work: Callable[[Band], Tensor]) -> Tensor:
    """Return the sum [N,16] of the results of `work` for all bands, added in their order.

    Raises the GpuError of `work_bands`.
    """
    parts = work_bands(launcher, projected, bands, work)
    _, total = next(parts)
    for _, part in parts:
        total += part
    return total


@cache
def _total_memory(device: torch.device) -> int:
    return torch.cuda.get_device_properties(device).total_memory


def _try(work: Callable[[Band], Result], band: Band) -> Result | _OutOfMemory:
    try:
        return work(band)
    except torch.OutOfMemoryError as error:
        return _OutOfMemory(str(error))


def _cut(launcher: Launcher, projected: Projected, band: Band, most: int) -> Iterator[Band]:
    one_row = band.end - band.first == 1
    if one_row and band.pairs > MAX_PAIRS:
        raise GpuError(
            f"a row of tiles of this view has {band.pairs} pairs of splats and tiles, more than the limit of "
            f"{MAX_PAIRS}; {CURE}"
        )
    if one_row or band.pairs <= most:
        yield band
        return
    for half in _halves(launcher, projected, band):
        yield from _cut(launcher, projected, half, most)


def _halve(launcher: Launcher, projected: Projected, band: Band, reason: str) -> tuple[Band, Band]:
    """Halve a band that did not fit into the memory.

    First, torch's cache is freed, because the driver needs memory of its own.
    """
    if projected.records.is_cuda:
        torch.cuda.empty_cache()
    if band.end - band.first > 1:
        try:
            return _halves(launcher, projected, band)
        except torch.OutOfMemoryError as error:
            reason = str(error)
    raise GpuError(
        f"the GPU's memory cannot hold {band.pairs} pairs of splats and tiles in {band.end - band.first} row(s) of "
        f"tiles ({reason}); {CURE}"
    )


def _halves(launcher: Launcher, projected: Projected, band: Band) -> tuple[Band, Band]:
    middle = (band.first + band.end) // 2
    return _counted(launcher, projected, band.first, middle), _counted(launcher, projected, middle, band.end)


def _counted(launcher: Launcher, projected: Projected, first: int, end: int) -> Band:
    in_all = projected.whole.tile_counts
    tile_counts = torch.empty_like(in_all)
    arrays = addresses(projected.outlines, in_all, tile_counts)
    params = CountParams(len(in_all), projected.width, projected.height, TileRows(first, end), *arrays)
    launcher.launch("tiles", "tiles_count", -(-len(in_all) // THREADS), THREADS, params)
    return Band(first, end, tile_counts, int(tile_counts.sum(dtype=torch.int64)))
