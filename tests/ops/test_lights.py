"""Reflected light put together, against torch's own sum and gradients in float64, on every kernel."""

from __future__ import annotations

import pytest
import torch

from mgsr.errors import TensorError
from mgsr.ops.lights import OFFSET, add_reflection, light_up
from tests.cuda.machines import Machine, on_every_kernel


def random(*shapes: tuple[int, ...]) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.rand(shape, generator=generator) for shape in shapes]


def assert_gradients_agree(ours: list[torch.Tensor], theirs: list[torch.Tensor]) -> None:
    for one, other in zip(ours, theirs, strict=True):
        assert one.grad is not None and torch.allclose(one.grad.cpu().double(), other.grad, atol=1e-6)


@on_every_kernel
@pytest.mark.parametrize("lights", [("own",), ("mirrored",), ("own", "mirrored")], ids="+".join)
def test_reflected_light_is_added(machine: Machine, lights: tuple[str, ...]) -> None:
    inputs = random((5, 7, 3), (5, 7), *((5, 7, 3) for _ in lights))
    leaves = [each.clone().to(machine.device).requires_grad_() for each in inputs]
    twins = [each.double().requires_grad_() for each in inputs]
    v_color = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(1))
    named = dict(zip(lights, leaves[2:], strict=True))
    with machine.running():
        color, reflected = add_reflection(leaves[0], leaves[1], named.get("own"), named.get("mirrored"))
        color.backward(v_color.to(machine.device))
    expected = twins[0] + twins[1][..., None] * sum(twins[2:])
    expected.backward(v_color.double())
    assert torch.allclose(color.detach().cpu().double(), expected, atol=1e-6)
    assert torch.allclose(reflected.detach().cpu().double(), sum(twins[2:]), atol=1e-6)
    assert_gradients_agree(leaves, twins)


@on_every_kernel
def test_a_flash_lights_the_object_alone(machine: Machine) -> None:
    inputs = random((5, 7, 3), (5, 7), (3,), (5, 7))
    even, alpha, background, lit = (each.clone().to(machine.device) for each in inputs)
    twins = [each.double() for each in inputs]
    leaves, exact = [even.requires_grad_(), alpha.requires_grad_()], [each.requires_grad_() for each in twins[:2]]
    v_image = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(1))
    with machine.running():
        image = light_up(even, alpha, background, lit)
        image.backward(v_image.to(machine.device))
    # sRGB is linear in light^(1/2.4) but for an offset, and what lies behind is not lit.
    behind = (1 - exact[1])[..., None] * twins[2]
    own = exact[0] - behind + exact[1][..., None] * OFFSET
    expected = own * twins[3][..., None] - exact[1][..., None] * OFFSET + behind
    expected.backward(v_image.double())
    assert torch.allclose(image.detach().cpu().double(), expected, atol=1e-6)
    assert_gradients_agree(leaves, exact)


def test_a_wrong_shape_is_named() -> None:
    color, weight = torch.zeros(4, 5, 3), torch.zeros(4, 5)
    with pytest.raises(TensorError, match=r"mirrored: expected \[H=4, W=5, 3\]"):
        add_reflection(color, weight, None, color[:3])
