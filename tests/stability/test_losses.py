"""Losses on masks of nothing and of everything, on empty views, constant images and depths of zero, on every kernel."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from torch import Tensor

from mgsr.config import DepthUnit, make_config
from mgsr.data.camera import Camera
from mgsr.gaussians.start import start_gaussians, start_surfels
from mgsr.losses.objective import depth_agreement, depth_unit, gaussian_terms, mutual_terms, surfel_terms, total
from mgsr.losses.target import Target
from mgsr.ops.depth_normals import depth_to_normals, normal_agreement_term
from mgsr.ops.image_loss import image_loss
from mgsr.ops.terms import scalar
from mgsr.ops.tv import edge_aware_tv
from mgsr.renderers.gaussians import render_gaussians
from mgsr.renderers.surfels import render_surfels
from tests.cuda.machines import Machine, on_every_kernel
from tests.optional import present
from tests.oracles import image_loss as loss_oracle
from tests.stability.branches import facing_camera
from tests.training.ball import ball_points

SIDE = 24


def noise(seed: int, *shape: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def differentiated(machine: Machine, loss: Callable[[Tensor], Tensor], values: Tensor) -> tuple[float, Tensor]:
    """Return the loss of values on a machine, and its gradient."""
    leaf = values.clone().to(machine.device).requires_grad_()
    with machine.running():
        result = loss(leaf)
        result.backward()
    assert leaf.grad is not None
    return float(result.detach()), leaf.grad.cpu()


@on_every_kernel
@pytest.mark.parametrize("other", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_constant_images(machine: Machine, value: float, other: float) -> None:
    """Check black, grey and saturated images, whose variance is rounding alone, against the oracle."""
    image, target = torch.full((SIDE, SIDE, 3), value), torch.full((SIDE, SIDE, 3), other)
    loss, gradient = differentiated(machine, lambda x: image_loss(x, target.to(machine.device)), image)
    exact = image.double().requires_grad_()
    expected = loss_oracle.image_loss(exact, target.double())
    expected.backward()
    assert loss == pytest.approx(float(expected.detach()), abs=2e-5)
    assert exact.grad is not None
    # Relative to what an image that differs gets: 0.8 of a pixel's share.
    assert (gradient - exact.grad).abs().max() < 2e-3 * 0.8 / image.numel()


@on_every_kernel
def test_a_constant_image_against_a_textured_one(machine: Machine) -> None:
    image, target = torch.full((SIDE, SIDE, 3), 1.0), noise(0, SIDE, SIDE, 3)
    loss, gradient = differentiated(machine, lambda x: image_loss(x, target.to(machine.device)), image)
    exact = image.double().requires_grad_()
    expected = loss_oracle.image_loss(exact, target.double())
    expected.backward()
    assert loss == pytest.approx(float(expected.detach()), abs=2e-5)
    assert exact.grad is not None
    assert (gradient - exact.grad).abs().max() < 1e-3 * exact.grad.abs().max()


@on_every_kernel
def test_masks_of_nothing_and_of_everything(machine: Machine) -> None:
    image, target = noise(1, SIDE, SIDE, 3), noise(2, SIDE, SIDE, 3).to(machine.device)
    nothing, everything = (torch.full((SIDE, SIDE), value, device=machine.device) for value in (0.0, 1.0))
    losses: tuple[Callable[..., Tensor], ...] = (
        partial(image_loss, target=target),
        partial(edge_aware_tv, guide=target),
    )
    for loss in losses:
        value, gradient = differentiated(machine, partial(loss, mask=nothing), image)
        assert value == 0 and not gradient.any()
        masked = differentiated(machine, partial(loss, mask=everything), image)
        plain = differentiated(machine, partial(loss, mask=None), image)
        assert masked[0] == pytest.approx(plain[0], rel=1e-6)
        torch.testing.assert_close(masked[1], plain[1], rtol=1e-4, atol=1e-9)


@on_every_kernel
@pytest.mark.parametrize("depth", [1e-6, 1.0, 1e6])
def test_normals_of_a_depth_with_holes(machine: Machine, depth: float) -> None:
    """Check that normals are zero where the depth or a neighbour's is zero, and unit elsewhere, at any distance."""
    depths = depth * (1 + 0.01 * noise(3, SIDE, SIDE))
    depths[5] = 0
    view = facing_camera(SIDE, SIDE)
    _, gradient = differentiated(machine, lambda d: depth_to_normals(d, view).sum(), depths)
    assert torch.isfinite(gradient).all() and not gradient[5].any()
    with machine.running():
        lengths = depth_to_normals(depths.to(machine.device), view).cpu().norm(dim=-1)
    assert not lengths[4:7].any()
    assert torch.allclose(lengths[8:-1, 1:-1], torch.ones(()), atol=1e-5)


@on_every_kernel
def test_nothing_covered_gives_no_normal_loss(machine: Machine) -> None:
    nothing = torch.zeros(SIDE, SIDE, device=machine.device)

    def loss(normal: Tensor) -> Tensor:
        return scalar(normal_agreement_term(normal, nothing, facing_camera(SIDE, SIDE), nothing, nothing))

    value, gradient = differentiated(machine, loss, noise(4, SIDE, SIDE, 3))
    assert value == 0 and not gradient.any()


@pytest.mark.parametrize("kind", list(DepthUnit))
def test_depths_of_an_empty_view_are_not_divided_by_zero(kind: DepthUnit) -> None:
    """Check that depths of an empty view are not divided by zero, nor those of a camera at the scene's very centre."""
    empty = torch.zeros(SIDE, SIDE, requires_grad=True)
    unit = depth_unit(kind, empty, distance=0.0)
    nothing = torch.zeros(SIDE, SIDE)
    loss = scalar(depth_agreement(empty, nothing, (nothing, nothing), unit))
    loss.backward()
    assert float(loss.detach()) == 0 and empty.grad is not None and not empty.grad.any()
    ones = torch.ones(2, 2)
    near = depth_agreement(ones, torch.zeros(2, 2), (ones, ones), depth_unit(kind, ones, 0))
    assert float(near) <= 100.0


@on_every_kernel
@pytest.mark.parametrize("mask", ["none", "nothing", "everything"])
@pytest.mark.parametrize("looks", ["away", "at it"])
def test_every_term_of_every_stage_is_finite(machine: Machine, looks: str, mask: str) -> None:
    """Check that every term is finite, for a camera that sees nothing and for one that sees the ball.

    Masks cover nothing or everything.
    """
    config, points, generator = make_config("standard").train, ball_points(60), torch.Generator().manual_seed(0)
    start = (points.positions, points.normals, points.colors)
    flat = start_surfels(*start, config.surfels, generator).to(machine.device)
    full = start_gaussians(*start, config.gaussians, generator, split=True).to(machine.device)
    models = (flat, full)
    leaves = [tensor.requires_grad_() for model in models for tensor in model.parameters().values()]
    view = facing_camera(SIDE, SIDE)
    pose = np.eye(4)
    pose[2, 3] = 2.5 if looks == "at it" else -2.5
    view = Camera(view.K, pose, SIDE, SIDE)
    alpha = None if mask == "none" else torch.full((SIDE, SIDE), float(mask == "everything"), device=machine.device)
    target = Target(torch.ones(SIDE, SIDE, 3, device=machine.device), alpha, view)
    with machine.running():
        surfels, gaussians = render_surfels(flat, view), render_gaussians(full, view)
        terms = [surfel_terms(surfels, target, config), gaussian_terms(gaussians, target, config)]
        losses = [total(each) for each in (*terms, mutual_terms(surfels, gaussians, target, config))]
        torch.stack([loss.value for loss in losses]).sum().backward()
    assert all(torch.isfinite(term) for loss in losses for term in loss.terms.values())
    assert all(leaf.grad is not None and torch.isfinite(leaf.grad).all() for leaf in leaves)
    if looks == "away":
        assert not any(present(leaf.grad).any() for leaf in leaves)
