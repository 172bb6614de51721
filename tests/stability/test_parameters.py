"""Quaternions, scales, shapes and opacities at the ends of what float32 holds, on every kernel."""

from __future__ import annotations

import math

import pytest
import torch

from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from tests.cuda.machines import Machine, on_every_kernel
from tests.ops.splat_scenes import camera
from tests.ops.test_surfels import NEARLY_EDGE_ON, edge_on_splats, held_camera
from tests.stability.branches import (
    STEEP,
    TOLERANCE,
    Setting,
    Splats,
    assert_close,
    before_camera,
    brute_force,
    compare,
    facing_camera,
    held,
    on_both_branches,
    render,
    scene,
    without,
)

ODD = 7  # the index of the splat that is not like the others


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("length", [1e-30, 1e-20, 1e-10, 1e10, 1e18, 1e20, 1e30])
def test_quaternions_of_any_length_are_the_same_rotation(machine: Machine, branch: str, length: float) -> None:
    """Check that quaternions of any length are the same rotation; the gradient goes with 1 / length.

    Squares of such numbers vanish or overflow in float32.
    """
    splats = before_camera(branch, 12)
    lengthened = splats | {"quats": (splats["quats"] * length).float().double()}
    got, expected = render(machine, branch, lengthened, facing_camera()), brute_force(branch, splats, facing_camera())
    got.assert_finite()
    assert_close(got.images, expected.images, TOLERANCE["images"])
    assert_close(got.gradients | {"quats": got.gradients["quats"] * length}, expected.gradients, TOLERANCE["gradients"])


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("quats", 0.0),
        ("quats", math.nan),
        ("quats", math.inf),
        ("scales", math.nan),
        ("scales", math.inf),
        ("scales", math.exp(90)),  # over float32's largest number
        ("means", math.nan),
        ("opacities", math.nan),
        ("colors", math.inf),
    ],
)
def test_a_splat_without_a_meaning_is_left_out(machine: Machine, branch: str, name: str, value: float) -> None:
    """Check that a splat with a meaningless number changes no bit of the others, whose gradients do not see it.

    Its own gradients are zero.
    """
    splats = before_camera(branch, 12)
    splats[name].view(12, -1)[ODD] = value
    got = render(machine, branch, splats, facing_camera())
    expected = render(machine, branch, without(splats, ODD), facing_camera())
    assert all(torch.equal(got.images[key], expected.images[key]) for key in got.images)
    assert all(torch.equal(without(got.gradients, ODD)[key], expected.gradients[key]) for key in got.gradients)
    assert not any(gradient[ODD].any() for gradient in got.gradients.values())
    assert got.radii is not None and got.radii[ODD] == 0


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("axes", [slice(0, 1), slice(None)], ids=["one", "all"])
@pytest.mark.parametrize("scale", [1e-6, 1e-15, math.exp(-90)])
def test_vanishing_scales_leave_the_low_pass(machine: Machine, branch: str, axes: slice, scale: float) -> None:
    """Check that a splat without any size is still a dot of the low-pass's.

    This holds also where float32 has only a subnormal scale.
    """
    splats = before_camera(branch, 12)
    splats["scales"][:, axes] = scale
    got = compare(machine, branch, held(splats), facing_camera())
    assert got.radii is not None and (got.radii > 0).all()


@on_every_kernel
@pytest.mark.parametrize("scale", [1e3, 1e6, 1e10, 1e18, 1e30])
@pytest.mark.parametrize("axes", [slice(0, 1), slice(None)], ids=["one", "all"])
def test_a_surfel_wider_than_the_world(machine: Machine, scale: float, axes: slice) -> None:
    """Check a plane, or a strip that reaches to its vanishing point, near which its depth has no bound."""
    splats = before_camera("surfels", 12)
    splats["scales"][ODD, axes] = scale
    compare(machine, "surfels", held(splats), facing_camera(), STEEP | {"images": 5e-4})


@on_every_kernel
@pytest.mark.parametrize("scale", [10.0, 1e3, 1e4, 1e5, 1e10, 1e30])
def test_a_gaussian_wider_than_the_world(machine: Machine, scale: float) -> None:
    """Check that a Gaussian fills the image up to a standard deviation of a million pixels.

    A larger one is left out.
    """
    splats = before_camera("gaussians", 12)
    splats["scales"][ODD] = scale
    if scale * 45 / float(splats["means"][ODD, 2]) < 1e6 / 2:
        compare(machine, "gaussians", held(splats), facing_camera(), STEEP)
    else:
        got = render(machine, "gaussians", splats, facing_camera())
        got.assert_finite()
        assert got.radii is not None and got.radii[ODD] == 0 and not got.gradients["scales"][ODD].any()


@on_every_kernel
@pytest.mark.parametrize("compensate", [False, True], ids=["plain", "compensated"])
@pytest.mark.parametrize("length", [0.5, 5.0, 50.0, 1000.0])
def test_gaussian_needles(machine: Machine, compensate: bool, length: float) -> None:
    """Check Gaussians ten thousand times longer than wide, from a part of a pixel to across many images."""
    splats = before_camera("gaussians", 20)
    splats["scales"][:] = torch.tensor([1.0, 1e-4, 1e-4]) * length
    compare(machine, "gaussians", held(splats), facing_camera(), setting=Setting(compensate=compensate))


@on_every_kernel
@pytest.mark.parametrize("length", [0.5, 5.0, 50.0])
def test_surfel_needles(machine: Machine, length: float) -> None:
    """Check surfels a thousandth of a pixel wide, which the low-pass draws.

    Where a pixel's centre lies on one by chance, its disk and the low-pass may be so near each other that rounding
    chooses whose gradient counts: seven splats in ten must have the oracle's.
    """
    splats = before_camera("surfels", 20)
    splats["scales"][:] = torch.tensor([1.0, 1e-4]) * length
    splats = held(splats)
    got, expected = render(machine, "surfels", splats, facing_camera()), brute_force("surfels", splats, facing_camera())
    got.assert_finite()
    assert_close(got.images, expected.images, 3 * STEEP["images"])
    for name, gradient in expected.gradients.items():
        error = (got.gradients[name] - gradient).reshape(20, -1).abs().amax(dim=1)
        assert (error < STEEP["gradients"] * gradient.abs().max().clamp(min=1)).double().mean() >= 0.7, name


@on_every_kernel
@on_both_branches
@pytest.mark.parametrize("sine", [1e-2, 2e-3, 1.1e-3, 9e-4, 1e-4, 1e-5, 1e-6])
def test_seen_from_the_edge(machine: Machine, branch: str, sine: float) -> None:
    """Check splats across the angle, 1e-3, below which a surfel's disk no longer counts; Gaussians are as flat."""
    splats = edge_on_splats(30, sine)
    if branch == "gaussians":
        flat = torch.cat([splats["scales"], 1e-4 * splats["scales"][:, :1]], dim=1)
        splats = scene("gaussians", 30) | splats | {"scales": flat}
    compare(machine, branch, held(splats), held_camera(), NEARLY_EDGE_ON)


@on_every_kernel
def test_an_exactly_edge_on_surfel_has_either_normal(machine: Machine) -> None:
    """Check that an exactly edge-on surfel has its normal up to the sign, and everything else right.

    Under 1e-7 rad float32 can't say which side is seen.
    """
    splats, images = held(edge_on_splats(1, 1e-8)), ("color", "alpha", "depth")
    got = render(machine, "surfels", splats, camera(), Setting(images=images))
    expected = brute_force("surfels", splats, camera(), Setting(images=images))
    normal, other = got.images.pop("normal"), expected.images.pop("normal")
    assert min((normal - other).abs().max(), (normal + other).abs().max()) < STEEP["images"]
    assert_close(got.images, expected.images, STEEP["images"])
    assert_close(got.gradients, expected.gradients, STEEP["gradients"])


@on_every_kernel
@pytest.mark.parametrize("size", [0.8, 0.95, 1.0, 1.05, 1.3])
def test_disks_as_small_as_the_low_pass(machine: Machine, size: float) -> None:
    """Check facing surfels of about the low-pass's own width.

    The stronger of the two changes from pixel to pixel, or, at 1, both are equal everywhere and only the gradient says
    which was taken.
    """
    splats = before_camera("surfels", 12)
    splats["quats"][:] = torch.tensor([1.0, 0, 0, 0])
    pixel = splats["means"][:, 2:] / 45
    splats["scales"][:] = size * 0.1**0.5 * pixel
    setting = Setting(images=()) if size == 1.0 else Setting()
    compare(machine, "surfels", held(splats), facing_camera(), STEEP, setting)


@on_every_kernel
@on_both_branches
def test_opacity_logits_from_minus_to_plus_30(machine: Machine, branch: str) -> None:
    """Check opacity logits from -30, whose sigmoid is 9e-14, to 30, whose sigmoid is 1 in float32.

    Faint surfels are culled, and get no gradient.
    """
    splats = before_camera(branch, 31)
    logits = torch.linspace(-30, 30, 31)
    splats["opacities"] = logits.sigmoid().double()
    got = compare(machine, branch, splats, facing_camera())
    faint = logits < -6
    if branch == "surfels":
        assert not got.gradients["opacities"][faint].any()


@on_both_branches
def test_log_scales_over_floats_range_send_no_nan(branch: str) -> None:
    """Check that log-scales over float32's range send no NaN.

    exp(90) is infinite in float32, and a gradient of zero times that is NaN.
    """
    model = _model(branch, before_camera(branch, 12))
    model.log_scales.data[ODD] = 90.0
    model.log_scales.requires_grad_()
    splats = before_camera(branch, 12)
    got = model.scales()
    (got * torch.where(torch.isfinite(got), torch.ones_like(got), torch.zeros_like(got))).nan_to_num().sum().backward()
    gradient = model.log_scales.grad
    assert gradient is not None and torch.isfinite(gradient).all() and not gradient[ODD].any()
    assert torch.equal(gradient[:ODD], splats["scales"][:ODD].float().log().exp())


def _model(branch: str, splats: Splats) -> SurfelModel | GaussianModel:
    numbers = {name: tensor.float() for name, tensor in splats.items()}
    parameters = {
        "means": numbers["means"],
        "quats": numbers["quats"],
        "log_scales": numbers["scales"].log(),
        "opacity_logits": numbers["opacities"].logit(),
        "sh": numbers["colors"][:, None],
    }
    return SurfelModel(**parameters) if branch == "surfels" else GaussianModel(**parameters, low_pass=0.05)
