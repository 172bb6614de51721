"""The patches of a tile that a splat touches, against all of their pixels: none too few, and hardly one too many."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from mgsr.native.cuda import tiles
from mgsr.native.cuda.gaussians import GaussianProjectParams, splats_struct
from mgsr.native.cuda.params import Int, Long, Pointer, pointer, pointers
from mgsr.native.cuda.tiles import TILE
from mgsr.native.structs import GaussianSplats, GaussianView
from tests.cuda_shim import launcher
from tests.cuda_shim.launcher import HERE, ShimLauncher, compile_with_shim
from tests.ops.splat_scenes import camera

WIDTH, HEIGHT = 64, 48
RADIUS = 10  # of an outline, its column


class Params(ctypes.Structure):
    _fields_ = (
        ("count", Long),
        *pointers("records", "outlines"),
        ("tiles", tiles.Tiles),
        ("tile", Int),
        *(("of_" + name, Pointer) for name in ("records", "outlines")),
    )


@pytest.fixture(scope="module", autouse=True)
def kernels() -> Iterator[None]:
    library = ctypes.CDLL(str(compile_with_shim(HERE / "patches.cu")), mode=os.RTLD_LOCAL)
    before = launcher.load_library
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launcher, "load_library", lambda family: library if family == "patches" else before(family))
        yield


def project(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return records [N,16] and outlines [N,12] of seen splats, round ones and needles, all over the image."""
    g = torch.Generator().manual_seed(3)
    splats = GaussianSplats(
        means=torch.rand(count, 3, generator=g) * 2 - 1,
        quats=torch.randn(count, 4, generator=g),
        scales=0.02 * torch.exp(1.2 * torch.randn(count, 3, generator=g)),
        opacities=torch.rand(count, generator=g) ** 2,
        colors=torch.rand(count, 3, generator=g),
        refl_opacities=None,
        refl_colors=None,
        weights=None,
        background=torch.zeros(3),
    )
    view = GaussianView(camera=camera(WIDTH, HEIGHT), near=0.01, low_pass=0.3, compensate=False)
    struct = splats_struct(splats, view)
    projected = tiles.project(ShimLauncher(), "gaussians", GaussianProjectParams, struct, torch.empty(count))
    seen = projected.whole.tile_counts > 0
    return projected.records[seen].numpy(), projected.outlines[seen].numpy()


def touched(records: np.ndarray, outlines: np.ndarray, tile: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the patches of a tile that the kernels find touched, [N,8]: by records, and by outlines."""
    across = -(-WIDTH // TILE)
    rows = -(-HEIGHT // TILE)
    found = [torch.empty(len(records), dtype=torch.int32) for _ in range(2)]
    size = tiles.Tiles(WIDTH, HEIGHT, across, across * rows, tiles.TileRows(0, rows), None, None, None)
    given = (torch.tensor(records), torch.tensor(outlines))
    params = Params(len(records), *(pointer(t) for t in given), size, tile, *(pointer(t) for t in found))
    ShimLauncher().launch("patches", "touched", -(-len(records) // 128), 128, params)
    bits = [(t.numpy()[:, None] >> np.arange(8)) & 1 == 1 for t in found]
    return bits[0], bits[1]


def pixel_centers(tile: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y [8,32] of each patch's pixels."""
    across = -(-WIDTH // TILE)
    patch, place = np.arange(8)[:, None], np.arange(32)[None]
    x = tile % across * TILE + patch % 2 * 8 + place % 8
    y = tile // across * TILE + patch // 2 * 4 + place // 8
    return x + 0.5, y + 0.5


def counted(records: np.ndarray, tile: int) -> np.ndarray:
    """Return whether a splat's alpha reaches 1/255 at a pixel [N,8,32], in float64."""
    x, y = pixel_centers(tile)
    whole = np.ascontiguousarray(records[:, :1]).view(np.int16)
    center = whole + records[:, 1:3].astype(np.float64)
    dx, dy = x - center[:, :1, None], y - center[:, 1:, None]
    a, b, c = (records[:, k, None, None].astype(np.float64) for k in (3, 4, 5))
    return records[:, 6, None, None] * np.exp2(-((a * dx + b * dy) ** 2) - (c * dy) ** 2) >= 1 / 255


@pytest.mark.parametrize("tile", range(12))
def test_of_records_and_outlines(tile: int) -> None:
    records, outlines = project(3000)
    expected = counted(records, tile).any(2)
    for found in touched(records, outlines, tile):
        assert expected.any() and not (expected & ~found).any()
        assert found.sum() < 1.25 * expected.sum() + 20


@pytest.mark.parametrize("radius", [0.5, 4.0, 30.0])
def test_of_outlines_with_a_circle(radius: float) -> None:
    records, outlines = project(1000)
    outlines[:, RADIUS] = radius
    x, y = pixel_centers(5)
    far2 = (x - outlines[:, 8, None, None]) ** 2 + (y - outlines[:, 9, None, None]) ** 2
    expected = (counted(records, 5) | (far2 <= 0.9999 * radius**2)).any(2)
    found = touched(records, outlines, 5)[1]
    assert not (expected & ~found).any() and found.sum() < 1.35 * expected.sum() + 20
