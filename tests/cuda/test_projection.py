"""The 3D branch's projection in two floats: it decides as float64 does, or says that it is unsure, which is rare."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.native.cuda.gaussians import GaussianProjectParams, splats_struct
from mgsr.native.cuda.params import Pointer, pointer
from mgsr.native.cuda.tiles import OUTLINE_FLOATS, RECORD_FLOATS, SPLAT_THREADS, splat_blocks
from mgsr.native.structs import GaussianSplats, GaussianView
from tests.cuda_shim import launcher
from tests.cuda_shim.launcher import HERE, ShimLauncher, compile_with_shim
from tests.ops.splat_scenes import camera

SEEN, UNSEEN, UNSURE = range(3)
NEAR = 0.2
LOW_PASS = 0.3


class Params(ctypes.Structure):
    _fields_ = (("to", GaussianProjectParams), ("sights", Pointer))


@dataclass(frozen=True)
class Splats:
    """Splats in float32: means [N,3], quats [N,4], scales [N,3], opacities [N]."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor


@dataclass(frozen=True)
class Projection:
    """The projection of splats.

    sights [N], records [N,16] and outlines [N,12] where seen, depths [N], tile_counts [N], radii [N].
    """

    sights: np.ndarray
    records: np.ndarray
    outlines: np.ndarray
    depths: np.ndarray
    tile_counts: np.ndarray
    radii: np.ndarray


@pytest.fixture(scope="module", autouse=True)
def kernels() -> Iterator[None]:
    library = ctypes.CDLL(str(compile_with_shim(HERE / "projection.cu")), mode=os.RTLD_LOCAL)
    before = launcher.load_library
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launcher, "load_library", lambda family: library if family == "projection" else before(family))
        yield


def project(kernel: str, splats: Splats, view: Camera, compensate: bool) -> Projection:
    count = len(splats.means)
    given = GaussianSplats(
        means=splats.means,
        quats=splats.quats,
        scales=splats.scales,
        opacities=splats.opacities,
        colors=torch.zeros(count, 3),
        refl_opacities=None,
        refl_colors=None,
        weights=None,
        background=torch.zeros(3),
    )
    struct = splats_struct(given, GaussianView(camera=view, near=NEAR, low_pass=LOW_PASS, compensate=compensate))
    records, outlines = torch.zeros(count, RECORD_FLOATS), torch.zeros(count, OUTLINE_FLOATS)
    depths, radii = torch.zeros(count), torch.zeros(count)
    tile_counts, sights = torch.zeros(count, dtype=torch.int32), torch.zeros(count, dtype=torch.int32)
    arrays = (pointer(t) for t in (records, outlines, depths, tile_counts, radii))
    params = Params(GaussianProjectParams(struct, *arrays), pointer(sights))
    ShimLauncher().launch("projection", kernel, splat_blocks(count), SPLAT_THREADS, params)
    return Projection(*(t.numpy() for t in (sights, records, outlines, depths, tile_counts, radii)))


def ball(count: int) -> Splats:
    """Draw round and flat and needle-shaped splats of many sizes, some behind the camera or beside the image."""
    g = torch.Generator().manual_seed(1)
    return Splats(
        torch.randn(count, 3, generator=g) * 1.5,
        torch.randn(count, 4, generator=g),
        0.05 * torch.exp(1.5 * torch.randn(count, 3, generator=g)),
        torch.rand(count, generator=g),
    )


def around_one(count: int) -> np.ndarray:
    """Draw factors that differ from 1 by 1e-8 to 1e-3, either way."""
    sizes = 10 ** np.linspace(-8, -3, count)
    return 1 + np.where(np.arange(count) % 2, sizes, -sizes)


def at_the_near_plane(count: int) -> Splats:
    """Draw splats with depths on both sides of the near plane, as near to it as float can say."""
    splats = ball(count)
    depth = NEAR * around_one(count)
    view = camera()
    x = np.stack([0.01 * np.ones(count), np.zeros(count), depth])
    R, t = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3:]
    means = torch.tensor((R.T @ (x - t)).T, dtype=torch.float32).contiguous()
    return Splats(means, splats.quats, 0.01 * torch.ones(count, 3), splats.opacities)


def at_the_least_opacity(count: int) -> Splats:
    """Draw splats with opacities that the compensation takes nearly to 1/255."""
    splats = ball(count)
    round_ = Splats(splats.means * 0.2, splats.quats, torch.full((count, 3), 0.01), torch.ones(count))
    compensation = project("in_double", round_, camera(), True).records[:, 6].view(np.float32)
    opacities = torch.tensor(around_one(count) / 255 / compensation).float()
    return Splats(round_.means, round_.quats, round_.scales, opacities)


def at_the_edges_of_tiles(count: int) -> Splats:
    """Draw splats with outlines that end a few hundred-thousandths of a pixel from a tile's pixel's centre."""
    splats = ball(count)
    view = camera()
    mild = Splats(0.2 * splats.means, splats.quats, torch.full((count, 3), 0.03), splats.opacities.clamp(0.1, 1))
    outlines = project("in_double", mild, view, False).outlines.astype(np.float64)
    edge = outlines[:, 0] + outlines[:, 2] + 2e-3
    wanted = 16 * np.round(edge / 16) + 0.5 + np.linspace(-2e-5, 2e-5, count)
    R, t = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3]
    p = mild.means.numpy().astype(np.float64) @ R.T + t
    p[:, 0] += (wanted - edge) * p[:, 2] / view.K[0, 0]
    return Splats(torch.tensor((p - t) @ R).float().contiguous(), mild.quats, mild.scales, mild.opacities)


def needles(count: int) -> Splats:
    """Draw splats up to ten million times longer than wide on the image."""
    splats = ball(count)
    lengths = torch.logspace(0, 6, count)
    scales = torch.stack([lengths, torch.full((count,), 1e-3), torch.full((count,), 1e-3)], 1)
    return Splats(splats.means * 0.2, splats.quats, scales, splats.opacities)


def extremes(count: int) -> Splats:
    """Draw splats with numbers from 1e-30 to 1e30, zeros, infinities and NaN."""
    g = torch.Generator().manual_seed(2)

    def wild(*shape: int) -> Tensor:
        sizes = torch.tensor([0.0, 1e-30, 1e-12, 1e-3, 1.0, 1e3, 1e12, 1e30, torch.inf, torch.nan])
        pick = sizes[torch.randint(len(sizes), shape, generator=g)]
        return torch.where(torch.rand(shape, generator=g) < 0.8, torch.rand(shape, generator=g), pick)

    return Splats(wild(count, 3) - 0.5, wild(count, 4) - 0.5, wild(count, 3), wild(count))


SCENES = [ball, at_the_near_plane, at_the_least_opacity, at_the_edges_of_tiles, needles, extremes]
each_scene = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
compensated_or_not = pytest.mark.parametrize("compensate", [False, True], ids=["plain", "compensated"])


@compensated_or_not
@each_scene
def test_decides_as_float64(scene: Callable[[int], Splats], compensate: bool) -> None:
    splats = scene(10_000)
    quick = project("in_two_floats", splats, camera(), compensate)
    exact = project("in_double", splats, camera(), compensate)
    sure = quick.sights != UNSURE
    assert sure.any() and np.array_equal(quick.sights[sure], exact.sights[sure])
    assert np.array_equal(quick.tile_counts[sure], exact.tile_counts[sure])


@compensated_or_not
@each_scene
def test_where_unsure_is_float64(scene: Callable[[int], Splats], compensate: bool) -> None:
    splats = scene(10_000)
    projected = project("as_projected", splats, camera(), compensate)
    exact = project("in_double", splats, camera(), compensate)
    assert np.array_equal(projected.tile_counts, exact.tile_counts)
    assert np.array_equal(projected.sights == SEEN, exact.sights == SEEN)


@compensated_or_not
def test_unsure_is_rare(compensate: bool) -> None:
    """Check that unsure splats are rare: a warp of 32 waits for each of its splats that is done again."""
    sights = project("in_two_floats", ball(10_000), camera(), compensate).sights
    assert (sights == UNSURE).mean() < 1e-3


@pytest.mark.parametrize("scene", [ball, needles], ids=lambda scene: scene.__name__)
def test_keeps_the_digits_of_a_record(scene: Callable[[int], Splats]) -> None:
    """Check that records keep float's last bit, for centres far from the image's corner and shapes as long as any."""
    splats = scene(10_000)
    quick = project("in_two_floats", splats, camera(4000, 3000), False)
    exact = project("in_double", splats, camera(4000, 3000), False)
    both = (quick.sights == SEEN) & (exact.sights == SEEN)
    ours, theirs = quick.records[both], exact.records[both]
    assert np.array_equal(ours[:, :1].view(np.int16), theirs[:, :1].view(np.int16))
    assert np.abs(ours[:, 1:3] - theirs[:, 1:3]).max() < 1e-7
    scale = np.sqrt(np.abs(theirs[:, 3] * theirs[:, 5]))
    assert (
        np.abs(ours[:, 3:6] - theirs[:, 3:6]).max(1) < 2e-7 * np.maximum(scale, np.abs(theirs[:, 3:6]).max(1))
    ).all()
    assert (ours[:, 1:] != theirs[:, 1:]).mean() < 1e-3
