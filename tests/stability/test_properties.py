"""Properties of any scene, drawn at random: order, background, transmittance, rigid motion, refinement."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mgsr.data.camera import Camera
from tests.cuda.machines import PROCESSOR, SHIM, Machine, on_every_kernel
from tests.ops.splat_scenes import camera
from tests.stability import branches
from tests.stability.branches import Result, Splats, assert_close, held, scene

# Rounding of the projection, seen through the steepest weights.
ROUNDING = {"images": 2e-4, "gradients": 5e-3}

drawn_scenes = st.builds(
    lambda branch, count, seed, size, opacity: (branch, drawn(branch, count, seed, size, opacity)),
    branch=st.sampled_from(["surfels", "gaussians"]),
    count=st.integers(1, 40),
    seed=st.integers(0, 2**31),
    size=st.floats(0.02, 0.6),
    opacity=st.floats(0.05, 1.0),
)


def drawn(branch: str, count: int, seed: int, size: float, opacity: float) -> Splats:
    splats = scene(branch, count, seed, size)
    splats["opacities"] *= opacity
    return held(splats)


Test = TypeVar("Test", bound=Callable[..., None])


def property_of(examples: int) -> Callable[[Test], Test]:
    """Return a decorator for tests over drawn scenes, the same ones at every run.

    They run on the processor's kernels, and a few under the shim.
    """

    def decorate(test: Test) -> Test:
        machines = pytest.mark.parametrize("machine", [PROCESSOR, SHIM], ids=lambda machine: machine.name)
        few = settings(
            max_examples=examples,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
        )
        decorated: Test = machines(few(test))
        return decorated

    return decorate


def render(machine: Machine, branch: str, splats: Splats, view: Camera) -> Result:
    return branches.render(machine, branch, splats, view)


@property_of(12)
@given(drawn_scenes, st.integers(0, 2**31))
def test_the_order_of_the_splats_does_not_matter(machine: Machine, drawn_scene: tuple[str, Splats], seed: int) -> None:
    """Check that the order of the splats does not matter, to the bit.

    Depths differ, and nothing is summed in the order of the splats.
    """
    branch, splats = drawn_scene
    order = torch.randperm(len(splats["means"]), generator=torch.Generator().manual_seed(seed))
    straight = render(machine, branch, splats, camera())
    mixed = render(machine, branch, {name: tensor[order] for name, tensor in splats.items()}, camera())
    assert all(torch.equal(straight.images[name], mixed.images[name]) for name in straight.images)
    assert all(torch.equal(straight.gradients[name][order], mixed.gradients[name]) for name in straight.gradients)


@property_of(12)
@given(drawn_scenes)
def test_the_background_adds_by_the_transmittance(machine: Machine, drawn_scene: tuple[str, Splats]) -> None:
    """Check that the image is linear in the background.

    What black splats let through plus what the splats show on black is the image.
    """
    branch, splats = drawn_scene
    image = render(machine, branch, splats, camera()).images
    dark = render(machine, branch, splats | {"colors": 0 * splats["colors"]}, camera()).images
    through = (1 - image["alpha"])[..., None] * branches.BACKGROUND
    assert (dark["color"] - through).abs().max() < 1e-6
    shown = image["color"] - dark["color"]
    assert shown.min() > -1e-6 and (shown <= image["alpha"][..., None] * splats["colors"].max() + 1e-5).all()


@property_of(12)
@given(drawn_scenes)
def test_transmittance_lies_between_0_and_1(machine: Machine, drawn_scene: tuple[str, Splats]) -> None:
    """Check that transmittance lies between 0 and 1, and never rises when a splat is added in front.

    The splat may only be lost where a pixel stops before the cut-off.
    """
    branch, splats = drawn_scene
    got = render(machine, branch, splats, camera())
    got.assert_finite()
    alpha = got.images["alpha"]
    assert alpha.min() >= 0 and alpha.max() <= 1 - 0.99e-4
    fewer = render(machine, branch, {name: tensor[1:] for name, tensor in splats.items()}, camera()).images["alpha"]
    open_pixels = alpha < 0.99
    assert (alpha - fewer)[open_pixels].min() > -1e-5 if open_pixels.any() else True


@property_of(12)
@given(drawn_scenes, st.integers(0, 2**31), st.floats(0, 3))
def test_a_rigid_motion_of_the_world_changes_nothing(
    machine: Machine, drawn_scene: tuple[str, Splats], seed: int, distance: float
) -> None:
    """Check that splats and camera moved together give the same images, and gradients that turn with the world."""
    branch, splats = drawn_scene
    turn = Rotation.random(rng=np.random.default_rng(seed))
    shift = distance * turn.as_matrix()[0]
    matrix = torch.tensor(turn.as_matrix())
    x, y, z, w = turn.as_quat()
    moved = splats | {
        "means": splats["means"] @ matrix.T + torch.tensor(shift),
        "quats": _product(torch.tensor([w, x, y, z]), splats["quats"]),
    }
    view = camera()
    pose = view.cam_from_world.copy()
    pose[:3, :3] = pose[:3, :3] @ turn.as_matrix().T
    pose[:3, 3] -= pose[:3, :3] @ shift
    here, there = (
        render(machine, branch, splats, view),
        render(machine, branch, held(moved), Camera(view.K, pose, view.width, view.height)),
    )
    # Normals are the world's, so they turn; of their gradients' random weights the test takes none.
    names = [name for name in here.images if name != "normal"]
    # A splat at the threshold of 1/255 may flip a pixel: all but one in a hundred agree.
    for name in names:
        error = (here.images[name] - there.images[name]).abs()
        assert (error > ROUNDING["images"] * max(1.0, float(here.images[name].abs().max()))).double().mean() < 0.01, (
            name
        )


@property_of(4)
@given(st.sampled_from(["surfels", "gaussians"]), st.integers(0, 2**31))
def test_refinement_converges(machine: Machine, branch: str, seed: int) -> None:
    """Check that the mean over a coarse pixel settles as cameras of ever more pixels see the same scene.

    Each step changes it by less.
    """
    splats = scene(branch, 10, seed, size=0.6)
    coarse = camera(20, 14, off_center=False)
    images = []
    for factor in (2, 4, 8):
        fine = coarse.resized(20 * factor, 14 * factor)
        color = render(machine, branch, splats, fine).images["color"]
        images.append(color.reshape(14, factor, 20, factor, 3).mean(dim=(1, 3)))
    first, second = (images[1] - images[0]).abs().mean(), (images[2] - images[1]).abs().mean()
    assert second < 0.7 * first + 1e-4


@on_every_kernel
@pytest.mark.parametrize("branch", ["surfels", "gaussians"])
def test_gradients_turn_with_the_world(machine: Machine, branch: str) -> None:
    """Check that the colour's and opacity's gradients of a moved world are the same, and the centres' are turned."""
    splats, view, turn = scene(branch, 30, 2), camera(), Rotation.from_euler("xyz", [0.3, -1.0, 2.0])
    matrix = torch.tensor(turn.as_matrix())
    x, y, z, w = turn.as_quat()
    quats = _product(torch.tensor([w, x, y, z]), splats["quats"])
    moved = held(splats | {"means": splats["means"] @ matrix.T, "quats": quats})
    pose = view.cam_from_world.copy()
    pose[:3, :3] = pose[:3, :3] @ turn.as_matrix().T
    setting = branches.Setting(images=("color", "alpha", "depth"))
    here = branches.render(machine, branch, splats, view, setting)
    there = branches.render(machine, branch, moved, Camera(view.K, pose, view.width, view.height), setting)
    turned = here.gradients | {"means": here.gradients["means"] @ matrix.T}
    names = ("means", "scales", "opacities", "colors")
    assert_close({n: there.gradients[n] for n in names}, {n: turned[n] for n in names}, ROUNDING["gradients"])


def _product(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Multiply the quaternion a [4] by each of b [N,4], wxyz."""
    w, v = a[0], a[1:]
    scalar = w * b[:, 0] - b[:, 1:] @ v
    vector = w * b[:, 1:] + b[:, :1] * v + torch.linalg.cross(v.expand(len(b), 3), b[:, 1:])
    return torch.cat([scalar[:, None], vector], dim=1)
