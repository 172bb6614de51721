"""The two lights put together."""

from __future__ import annotations

import torch

from mgsr.render.volumes import add_reflection


def test_sum_and_gradients_are_torchs_own() -> None:
    generator = torch.Generator().manual_seed(0)
    shapes = ((5, 7, 3), (5, 7, 3), (5, 7))
    inputs = [torch.rand(shape, generator=generator, requires_grad=True) for shape in shapes]
    twins = [tensor.detach().double().requires_grad_() for tensor in inputs]
    color, expected = add_reflection(*inputs), twins[0] + twins[2][..., None] * twins[1]
    assert torch.allclose(color.double(), expected, atol=1e-6)
    v_color = torch.rand(color.shape, generator=generator)
    color.backward(v_color)
    expected.backward(v_color.double())
    for ours, theirs in zip(inputs, twins, strict=True):
        assert torch.allclose(ours.grad.double(), theirs.grad, atol=1e-6)
