"""Scales and shares from stored numbers, against torch's own functions in float64, on every kernel."""

from __future__ import annotations

import math

import pytest
import torch

from mgsr.errors import TensorError
from mgsr.ops.activations import LARGEST_LOG_SCALE, activate, shares
from tests.cuda.machines import Machine, on_every_kernel


@on_every_kernel
@pytest.mark.parametrize("logits", [0, 1, 3])
def test_values_and_gradients(machine: Machine, logits: int) -> None:
    generator = torch.Generator().manual_seed(0)
    shapes = [(1500, 3)] + [(1500,)] * logits
    stored = [3 * torch.randn(shape, generator=generator) for shape in shapes]
    leaves = [each.clone().to(machine.device).requires_grad_() for each in stored]
    twins = [each.double().requires_grad_() for each in stored]
    v_used = [torch.randn(shape, generator=generator) for shape in shapes]
    with machine.running():
        used = activate(*leaves)
        torch.autograd.backward(used, [each.to(machine.device) for each in v_used])
    expected = [twins[0].exp(), *(each.sigmoid() for each in twins[1:])]
    torch.autograd.backward(expected, [each.double() for each in v_used])
    for one, other, leaf, twin in zip(used, expected, leaves, twins, strict=True):
        torch.testing.assert_close(one.detach().cpu().double(), other.detach(), rtol=2e-6, atol=1e-12)
        # 1 - y in float32, near 1
        assert leaf.grad is not None and twin.grad is not None
        assert (leaf.grad.cpu().double() - twin.grad).abs().max() <= 1e-6 * twin.grad.abs().max()


@on_every_kernel
def test_huge_scales_are_constant(machine: Machine) -> None:
    stored = torch.tensor([LARGEST_LOG_SCALE - 1, LARGEST_LOG_SCALE + 1, 1e4], device=machine.device)
    leaf = stored.requires_grad_()
    with machine.running():
        (scales,) = activate(leaf)
        (1e-30 * scales).sum().backward()
    assert scales.tolist() == pytest.approx([math.exp(79), math.exp(80), math.exp(80)], rel=1e-5)
    assert leaf.grad is not None
    assert leaf.grad.tolist() == pytest.approx([1e-30 * math.exp(79), 0.0, 0.0], rel=1e-5)


@on_every_kernel
def test_what_nothing_depends_on_gets_no_gradient(machine: Machine) -> None:
    log_scales, logits = (torch.zeros(7, device=machine.device, requires_grad=True) for _ in range(2))
    with machine.running():
        _, opacities = activate(log_scales, logits)
        opacities.sum().backward()
    assert logits.grad is not None
    assert logits.grad.tolist() == [0.25] * 7
    assert log_scales.grad is None or not log_scales.grad.any()


@on_every_kernel
def test_extreme_logits(machine: Machine) -> None:
    leaf = torch.tensor([-200.0, 0.0, 200.0], device=machine.device, requires_grad=True)
    with machine.running():
        result = shares(leaf)
        result.sum().backward()
    assert result.tolist() == pytest.approx([0.0, 0.5, 1.0], abs=1e-30)
    assert leaf.grad is not None
    assert torch.isfinite(leaf.grad).all()


def test_gradients_of_gradients_are_refused() -> None:
    """Check that gradients of gradients are refused; torch would else take them for zero."""
    leaf = torch.zeros(3, requires_grad=True)
    with pytest.raises(TensorError, match="create_graph: expected False, got True"):
        torch.autograd.grad(shares(leaf).sum(), leaf, create_graph=True)
