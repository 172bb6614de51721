"""Splats and cameras at difficult places, and scenes of other sizes and far from the origin, on every kernel."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mgsr.data.camera import Camera
from mgsr.ops.harmonics import harmonics_to_rgb
from tests.cuda.machines import Machine, on_every_kernel
from tests.ops.splat_scenes import camera
from tests.stability.branches import (
    STEEP,
    Setting,
    before_camera,
    compare,
    facing_camera,
    held,
    on_both_branches,
    render,
    scene,
)

ODD = 7
NEAR = float(np.float32(0.01))
JUST_BEYOND = float(np.nextafter(np.float32(NEAR), np.float32(1)))


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("beside", [0.0, 0.002])
@pytest.mark.parametrize("depth", [-0.01, -1e-7, 0.0, 0.0099, NEAR, JUST_BEYOND, 0.0101, 0.02])
def test_a_centre_around_the_near_plane(machine: Machine, branch: str, depth: float, beside: float) -> None:
    """Check that a splat is left out at the near plane and behind it, and counts just beyond it."""
    splats = before_camera(branch, 12)
    splats["means"][ODD] = torch.tensor([beside, 0.5 * beside, depth])
    got = compare(machine, branch, held(splats), facing_camera(), STEEP)
    assert got.radii is not None and (got.radii[ODD] > 0) == (depth > NEAR)


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize(("depth", "size"), [(0.05, 1.0), (0.5, 3.0), (0.011, 0.3)])
def test_a_camera_inside_a_splat(machine: Machine, branch: str, depth: float, size: float) -> None:
    splats = before_camera(branch, 12)
    splats["means"][ODD] = torch.tensor([0.0, 0.0, depth])
    splats["scales"][ODD] = size
    compare(machine, branch, held(splats), facing_camera(), STEEP)


@on_every_kernel
@on_both_branches
def test_a_camera_amid_large_splats(machine: Machine, branch: str) -> None:
    splats = before_camera(branch, 20, size=1.0)
    splats["means"][:, 2] -= 1.9
    compare(machine, branch, held(splats), facing_camera(), STEEP)


@on_every_kernel
@pytest.mark.parametrize("distance", [0.0, 1e-30, 1e-20, 1e-13])
def test_a_splat_at_the_camera_has_no_direction(machine: Machine, distance: float) -> None:
    """Check that a splat at the camera has the colour of the terms that do not vanish there, and no mean gradient."""
    sh = torch.randn(2, 16, 3, generator=torch.Generator().manual_seed(0)).to(machine.device).requires_grad_()
    means = torch.tensor([[distance, 0, 0], [0.3, 0.1, 1]], device=machine.device, requires_grad=True)
    with machine.running():
        colors = harmonics_to_rgb(sh, means, torch.zeros(3, device=machine.device), 3)
        colors.sum().backward()
    assert sh.grad is not None and means.grad is not None
    assert torch.isfinite(colors).all() and torch.isfinite(sh.grad).all() and torch.isfinite(means.grad).all()
    if distance == 0:
        expected = (0.28209479 * sh[0, 0] + 0.5).clamp(min=0)
        torch.testing.assert_close(colors[0], expected)
    assert not means.grad[0].any() and means.grad[1].any()


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_a_scene_in_another_unit(machine: Machine, branch: str, unit: float) -> None:
    """Check that in millimetres or kilometres the image is the same, and depths and gradients are in that unit."""
    splats = scene(branch, 40)
    splats["means"] *= unit
    splats["scales"] *= unit
    view = camera()
    pose = view.cam_from_world.copy()
    pose[:3, 3] *= unit
    setting = Setting(near=0.01 * unit, far=10 * unit)
    compare(machine, branch, held(splats), Camera(view.K, pose, view.width, view.height), setting=setting)


@on_every_kernel
@on_both_branches
def test_a_scene_far_from_the_origin(machine: Machine, branch: str) -> None:
    """Check that the same bits come out where a scene is moved by 10,000 along all axes.

    float32 still holds steps of 1/1024 there: with a camera along the axes nothing is rounded.
    """
    splats = before_camera(branch, 20)
    splats["means"] = (splats["means"] * 512).round() / 512
    shift = torch.tensor([10_000.0, -10_000.0, 10_000.0], dtype=torch.float64)
    view, pose = facing_camera(), np.eye(4)
    pose[:3, 3] = -shift.numpy()
    moved = splats | {"means": splats["means"] + shift}
    here = render(machine, branch, splats, view)
    there = render(machine, branch, moved, Camera(view.K, pose, view.width, view.height))
    for name in here.images:
        assert torch.equal(here.images[name], there.images[name]), name
    for name in here.gradients:
        assert torch.equal(here.gradients[name], there.gradients[name]), name


@on_every_kernel
@on_both_branches
def test_a_turned_camera_far_from_the_origin(machine: Machine, branch: str) -> None:
    """Check that the image is that of a camera moved by the rounding of its translation.

    That is 1e-3 there, 0.03 of a pixel.
    """
    splats = scene(branch, 40)
    shift = np.array([10_000.0, -10_000.0, 10_000.0])
    view = camera()
    pose = view.cam_from_world.copy()
    pose[:3, 3] -= pose[:3, :3] @ shift
    moved = held(splats | {"means": splats["means"] + torch.tensor(shift)})
    got = render(machine, branch, moved, Camera(view.K, pose, view.width, view.height))
    got.assert_finite()
    here = render(machine, branch, held(moved | {"means": moved["means"] - torch.tensor(shift)}), view)
    assert (got.images["color"] - here.images["color"]).abs().mean() < 5e-3
