"""The 3D branch's CUDA kernels against a brute-force float64 renderer, forward and every gradient."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.native.cuda import tiles
from mgsr.ops.gaussians import GaussianOptions, GaussianRaster, Reflected, rasterize_gaussians
from tests.cuda.machines import Machine, on_each_machine, on_each_machine_and_order
from tests.ops.splat_scenes import camera, random_splats, splat_arguments
from tests.ops.test_gaussians import (
    BACKGROUND,
    TOLERANCE,
    Rendered,
    assert_close,
    brute_force,
    dual_splats,
    native,
    run,
)
from tests.optional import present


def compare(
    machine: Machine, splats: dict[str, torch.Tensor], view: Camera, dual: bool = False, compensate: bool = False
) -> None:
    expected = run(brute_force, splats, view, torch.float64, dual, compensate)
    got = render(machine, splats, view, dual, compensate)
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert_close(got[1], expected[1], TOLERANCE["gradients"])


def render(
    machine: Machine, splats: dict[str, torch.Tensor], view: Camera, dual: bool = False, compensate: bool = False
) -> Rendered:
    """Render as `run`, in float32 on a machine; images and gradients come back to the CPU."""

    def on_machine(*arguments: Any) -> Images:
        *tensors, view, background, reflected, compensate = arguments
        reflected = tuple(t.to(machine.device) for t in reflected) if reflected else None
        splats = splat_arguments(t.to(machine.device) for t in tensors)
        out = native(*splats, view, background.to(machine.device), reflected, compensate)
        return Images(out)

    with machine.running():
        return run(on_machine, splats, view, torch.float32, dual, compensate)


class Images:
    """A raster's images, brought to the CPU within the graph."""

    def __init__(self, raster: GaussianRaster) -> None:
        for name in ("color", "alpha", "depth", "reflected", "weight"):
            image = getattr(raster, name)
            setattr(self, name, None if image is None else image.cpu())


@on_each_machine_and_order
@pytest.mark.parametrize("dual", [False, True], ids=["single", "dual"])
def test_matches_brute_force(machine: Machine, dual: bool) -> None:
    compare(machine, dual_splats(60) if dual else random_splats(60, 3), camera(), dual)


@on_each_machine
@pytest.mark.parametrize("dual", [False, True], ids=["single", "dual"])
def test_compensated(machine: Machine, dual: bool) -> None:
    compare(machine, dual_splats(60) if dual else random_splats(60, 3), camera(), dual, compensate=True)


@on_each_machine
@pytest.mark.parametrize("width,height", [(1, 1), (7, 9), (8, 8), (9, 17)])
def test_image_sizes_around_the_tile(machine: Machine, width: int, height: int) -> None:
    view = camera(width, height, off_center=False)
    compare(machine, random_splats(30, 3, seed=3, size=0.5), view)


@on_each_machine
def test_splats_across_many_tiles(machine: Machine) -> None:
    """Check wide and thin splats over 10 x 6 tiles, some of which reach far outside."""
    splats = dual_splats(40, seed=7)
    splats["scales"] *= torch.tensor([8.0, 1.0, 2.0], dtype=torch.float64)
    compare(machine, splats, camera(150, 90), dual=True)


@on_each_machine
def test_lists_of_many_buckets(machine: Machine) -> None:
    """Check hundreds of faint splats on each pixel of one tile: more than one batch of 256."""
    splats = dual_splats(700, seed=9)
    splats["opacities"] *= 0.06
    splats["refl_opacities"] *= 0.06
    splats["means"] *= 0.3
    splats["means"][::3, 2] -= 10
    compare(machine, splats, camera(16, 16, off_center=False), dual=True)


@on_each_machine
def test_stacked_opaque_layers_stop_and_stay_finite(machine: Machine) -> None:
    splats = random_splats(300, 3, seed=4, size=2.0)
    splats["opacities"][:] = 1.0
    expected = run(brute_force, splats, camera(), torch.float64, False)
    got = render(machine, splats, camera())
    assert_close(got[0], expected[0], TOLERANCE["images"])
    assert all(torch.isfinite(v).all() for v in got[1].values())


@on_each_machine_and_order
def test_the_same_bytes_at_every_run(machine: Machine) -> None:
    """Check that the bytes are the same at every run and in every order of threads and blocks.

    A difference would be a race.
    """
    splats = dual_splats(200, seed=5)
    reference = render(machine.ascending(), splats, camera(), dual=True)
    again = render(machine, splats, camera(), dual=True)
    for before, after in zip(reference, again, strict=True):
        assert all(torch.equal(before[name], after[name]) for name in before)


@on_each_machine
def test_agrees_with_the_processor(machine: Machine) -> None:
    splats = dual_splats(300, seed=2)
    ours, theirs = (
        render(machine, splats, camera(64, 48), True),
        run(native, splats, camera(64, 48), torch.float32, True),
    )
    assert_close(ours[0], theirs[0], 1e-5)
    assert_close(ours[1], theirs[1], 1e-4)


@on_each_machine
def test_long_keys_list_the_same(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that long keys give the same lists.

    An image of more than 32768 tiles has them: 4096 x 2160 has 34560.
    """
    splats = dual_splats(60)
    short = render(machine, splats, camera(), dual=True)
    monkeypatch.setattr(tiles, "SHORT_KEYS", 0)
    long = render(machine, splats, camera(), dual=True)
    for before, after in zip(short, long, strict=True):
        assert all(torch.equal(before[name], after[name]) for name in before)


@on_each_machine
def test_equal_depths_blend_by_index(machine: Machine) -> None:
    splats = random_splats(8, 3, seed=6)
    splats["means"][:] = torch.tensor([0.0, 0.0, 0.1], dtype=torch.float64)
    compare(machine, splats, camera())


@on_each_machine
@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "colors"])
def test_a_non_finite_splat_is_left_out(machine: Machine, field: str) -> None:
    splats = random_splats(20, 3)
    without = {k: torch.cat([v[:7], v[8:]]) for k, v in splats.items()}
    expected, expected_grads = render(machine, without, camera())
    for bad in (float("nan"), float("inf")):
        splats[field].view(20, -1)[7, 0] = bad
        got, grads = render(machine, splats, camera())
        assert all(torch.equal(got[k], expected[k]) for k in got)
        assert torch.equal(torch.cat([grads["means"][:7], grads["means"][8:]]), expected_grads["means"])
        assert not grads["means"][7].any()


@on_each_machine
def test_nothing_to_see(machine: Machine) -> None:
    view = camera()
    empty = {k: v[:0] for k, v in random_splats(1, 3).items()}
    behind = random_splats(5, 3)
    behind["means"][:, 2] -= 10
    for splats in (empty, behind):
        images, gradients = render(machine, splats, view)
        assert torch.equal(images["color"], BACKGROUND.double().expand(view.height, view.width, 3))
        assert not images["alpha"].any() and not images["depth"].any()
        assert all(not v.any() for v in gradients.values())


@on_each_machine
def test_statistics_and_rendering_without_gradients(machine: Machine) -> None:
    splats = {k: v.float().to(machine.device) for k, v in random_splats(30, 3).items()}
    names = ("means", "quats", "scales", "opacities", "colors")
    with machine.running():
        out = rasterize_gaussians(*splat_arguments(splats[k] for k in names), camera(), BACKGROUND.to(machine.device))
        leaves = [splats[k].clone().requires_grad_() for k in names]
        differentiable = rasterize_gaussians(*splat_arguments(leaves), camera(), BACKGROUND.to(machine.device))
        differentiable.color.sum().backward()
    assert torch.equal(out.color, differentiable.color)
    cpu = rasterize_gaussians(*splat_arguments(splats[k].cpu() for k in names), camera(), BACKGROUND)
    assert torch.equal(out.stats.visible.cpu(), cpu.stats.visible)
    torch.testing.assert_close(out.stats.radii.cpu(), cpu.stats.radii)
    assert differentiable.stats.v_means2d is not None
    assert differentiable.stats.v_means2d.shape == (30, 2) and differentiable.stats.v_means2d.any()


@on_each_machine
def test_images_without_a_gradient_count_as_zero(machine: Machine) -> None:
    """Check that images without a gradient count as zero, where only the reflected image has one."""
    splats = {k: v.float().to(machine.device).requires_grad_() for k, v in dual_splats(30).items()}
    reflected = Reflected(splats["refl_opacities"], splats["refl_colors"], splats["weights"])
    names = ("means", "quats", "scales", "opacities", "colors")
    tensors = splat_arguments(splats[k] for k in names)
    options = GaussianOptions(depth=False)
    with machine.running():
        out = rasterize_gaussians(*tensors, camera(), BACKGROUND.to(machine.device), reflected, options)
        present(out.reflected).sum().backward()
    assert splats["refl_colors"].grad is not None and splats["means"].grad is not None
    assert splats["refl_colors"].grad.any() and splats["means"].grad.any()
    assert splats["colors"].grad is not None and splats["opacities"].grad is not None
    assert not splats["colors"].grad.any() and not splats["opacities"].grad.any()
