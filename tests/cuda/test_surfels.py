"""The 2D branch's CUDA kernels against a brute-force float64 renderer, forward and every gradient."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.ops.raster import SplatStats
from mgsr.ops.surfels import SurfelOptions, SurfelRaster, rasterize_surfels
from tests.cuda.machines import Machine, on_each_machine, on_each_machine_and_order
from tests.ops.splat_scenes import camera, random_splats, splat_arguments
from tests.ops.test_surfels import (
    BACKGROUND,
    IMAGES,
    NEARLY_EDGE_ON,
    OPTIONS,
    SPLATS,
    STEEP,
    TOLERANCE,
    Rendered,
    assert_close,
    brute_force,
    edge_on_splats,
    held_camera,
    run,
    slanted_part,
)
from tests.oracles.surfels import MIN_ALPHA


class Images:
    """A raster's images, brought to the CPU within the graph."""

    def __init__(self, raster: SurfelRaster) -> None:
        self.stats: SplatStats = raster.stats
        for name in IMAGES:
            image = getattr(raster, name)
            setattr(self, name, None if image is None else image.cpu())


def render(
    machine: Machine,
    splats: dict[str, torch.Tensor],
    view: Camera,
    options: SurfelOptions = OPTIONS,
    images: tuple[str, ...] = IMAGES,
) -> Rendered:
    """Render as `run`, in float32 on a machine; images and gradients come back to the CPU."""

    def on_machine(*arguments: Any) -> Images:
        *tensors, view, background, options = arguments
        splats = splat_arguments(t.to(machine.device) for t in tensors)
        return Images(rasterize_surfels(*splats, view, background.to(machine.device), options))

    with machine.running():
        return run(on_machine, {k: v.float() for k, v in splats.items()}, view, torch.float32, options, images)


def compare(
    machine: Machine,
    splats: dict[str, torch.Tensor],
    view: Camera,
    tolerance: dict[str, float] = TOLERANCE,
    options: SurfelOptions = OPTIONS,
    images: tuple[str, ...] = IMAGES,
) -> None:
    expected = run(brute_force, splats, view, torch.float64, options, images)
    got = render(machine, splats, view, options, images)
    assert_close(got[0], expected[0], tolerance["images"])
    assert_close(got[1], expected[1], tolerance["gradients"])
    v_means2d = {"v_means2d": got[2].stats.v_means2d.double().cpu()}
    assert_close(v_means2d, {"v_means2d": expected[2].shift.grad}, tolerance["gradients"])


@on_each_machine_and_order
def test_matches_brute_force(machine: Machine) -> None:
    compare(machine, random_splats(60, 2, seed=20), camera())


@on_each_machine
@pytest.mark.parametrize("name", IMAGES)
def test_each_image_alone_sends_its_gradient(machine: Machine, name: str) -> None:
    compare(machine, random_splats(60, 2, seed=1), camera(), images=(name,))


@on_each_machine
def test_without_distortion(machine: Machine) -> None:
    splats, view = random_splats(60, 2, seed=2), camera()
    images, gradients, _ = render(machine, splats, view, images=IMAGES[:5])
    plain = render(machine, splats, view, replace(OPTIONS, distortion=False))
    assert plain[2].distortion is None
    assert all(torch.equal(plain[0][k], images[k]) for k in plain[0])
    assert_close(plain[1], gradients, 1e-6)


@on_each_machine
@pytest.mark.parametrize("size", [0.01, 0.03, 0.5, 2.0])
def test_small_splats_and_large(machine: Machine, size: float) -> None:
    """Check splats under a pixel, whose weight the low-pass gives, and large disks.

    The disks cross the image's border, and their planes slant.
    """
    compare(machine, random_splats(40, 2, seed=3, size=size), camera(), STEEP if size > 1 else TOLERANCE)


@on_each_machine
@pytest.mark.parametrize("sine", [1e-4, 5e-4, 1.1e-3, 2e-3, 0.01, 0.1])
def test_edge_on(machine: Machine, sine: float) -> None:
    compare(machine, edge_on_splats(40, sine), held_camera(), NEARLY_EDGE_ON)


@on_each_machine
def test_the_slanted_splats_of_a_large_scene(shared_data: Path, machine: Machine) -> None:
    splats, view = slanted_part(shared_data / "raster" / "s20k_256.npz", side=96)
    compare(machine, splats, view, NEARLY_EDGE_ON, SurfelOptions(distortion=True))


@on_each_machine
def test_disks_that_reach_behind_the_camera(machine: Machine) -> None:
    splats = random_splats(12, 2, seed=7, size=3.0)
    splats["means"][:, 2] -= 1.2
    compare(machine, splats, camera(), STEEP)


@on_each_machine
@pytest.mark.parametrize("width,height", [(1, 1), (7, 9), (8, 8), (9, 17)])
def test_image_sizes_around_the_tile(machine: Machine, width: int, height: int) -> None:
    compare(machine, random_splats(30, 2, seed=3, size=0.5), camera(width, height, off_center=False))


@on_each_machine
def test_splats_across_many_tiles(machine: Machine) -> None:
    """Check wide and thin splats over 10 x 6 tiles, some of which reach far outside."""
    splats = random_splats(40, 2, seed=12)
    splats["scales"] *= torch.tensor([6.0, 1.0], dtype=torch.float64)
    compare(machine, splats, camera(150, 90), STEEP)


@on_each_machine
def test_lists_of_many_buckets(machine: Machine) -> None:
    """Check hundreds of faint splats on each pixel of one tile: more than one batch of 128."""
    splats = random_splats(500, 2, seed=9)
    splats["opacities"] *= 0.06
    splats["means"] *= 0.3
    splats["means"][::3, 2] -= 10
    compare(machine, splats, camera(16, 16, off_center=False), STEEP)


@on_each_machine
def test_stacked_opaque_layers_stop_and_stay_finite(machine: Machine) -> None:
    splats = random_splats(200, 2, seed=4, size=2.0)
    splats["opacities"][:] = 1.0
    expected = run(brute_force, splats, camera(), torch.float64)
    got = render(machine, splats, camera())
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert all(torch.isfinite(v).all() for v in got[1].values())


@on_each_machine_and_order
def test_the_same_bytes_at_every_run(machine: Machine) -> None:
    """Check that the bytes are the same at every run and in every order of threads and blocks.

    A difference would be a race.
    """
    splats = random_splats(200, 2, seed=5)
    reference = render(machine.ascending(), splats, camera())
    again = render(machine, splats, camera())
    for before, after in zip(reference[:2], again[:2], strict=True):
        assert all(torch.equal(before[name], after[name]) for name in before)


@on_each_machine
def test_agrees_with_the_processor(machine: Machine) -> None:
    splats, view = random_splats(300, 2, seed=2), camera(64, 48)
    ours = render(machine, splats, view)
    theirs = run(rasterize_surfels, {k: v.float() for k, v in splats.items()}, view, torch.float32)
    assert_close(ours[0], theirs[0], 1e-5)
    assert_close(ours[1], theirs[1], 1e-4)
    torch.testing.assert_close(ours[2].stats.radii.cpu(), theirs[2].stats.radii)


@on_each_machine
@pytest.mark.parametrize("field", SPLATS)
def test_a_non_finite_splat_is_left_out(machine: Machine, field: str) -> None:
    splats = {k: v.float() for k, v in random_splats(20, 2).items()}
    without = {k: torch.cat([v[:7], v[8:]]) for k, v in splats.items()}
    expected = render(machine, without, camera())
    for bad in (float("nan"), float("inf")):
        splats[field].view(20, -1)[7, 0] = bad
        got = render(machine, splats, camera())
        assert all(torch.equal(got[0][k], expected[0][k]) for k in got[0])
        for name in SPLATS:
            assert torch.equal(torch.cat([got[1][name][:7], got[1][name][8:]]), expected[1][name])
            assert not got[1][name][7].any()
        assert not got[2].stats.visible[7]


@on_each_machine
def test_nothing_to_see(machine: Machine) -> None:
    view = camera()
    empty = {k: v[:0] for k, v in random_splats(1, 2).items()}
    behind, faint = random_splats(5, 2), random_splats(5, 2)
    behind["means"][:, 2] -= 10
    faint["opacities"][:] = 0.9 * MIN_ALPHA
    for splats in (empty, behind, faint):
        images, gradients, out = render(machine, splats, view)
        assert torch.equal(images["color"], BACKGROUND.double().expand(view.height, view.width, 3))
        assert all(not images[k].any() for k in IMAGES[1:])
        assert all(not gradients[k].any() for k in SPLATS)
        assert not out.stats.visible.any()
