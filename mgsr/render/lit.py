"""Colours lit by a flash: an image of an evenly lit object, and what the flash makes of each pixel, put together."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

# sRGB = (1 + OFFSET) light^(1/2.4) - OFFSET, away from black (IEC 61966-2-1).
OFFSET = 0.055


def light_up(even: Tensor, alpha: Tensor, background: Tensor, lit: Tensor) -> Tensor:
    """The image [H,W,3], in sRGB, of an object whose image under even light is `even` [H,W,3], with alpha [H,W] before
    `background` [3].

    lit [H,W]: the flash's light, 0..1, to the power 1/2.4. It falls on the object alone. Where that is nearly black,
    the result may lie below 0. Gradients flow to even and alpha.
    """
    image: Tensor = _LightUp.apply(even, alpha, background, lit)
    return image


class _LightUp(torch.autograd.Function):
    """Channel by channel: torch's broadcast over, and sum along, an axis of three is several times slower."""

    @staticmethod
    def forward(ctx: Any, even: Tensor, alpha: Tensor, background: Tensor, lit: Tensor) -> Tensor:
        ctx.save_for_backward(background, lit)
        lost = lit - 1
        image = torch.empty_like(even)
        for channel in range(3):
            # The object's light^(1/2.4), but for a factor: what lies behind is taken off, and the offset put on.
            own = even[..., channel] + alpha * (background[channel] + OFFSET) - background[channel]
            torch.addcmul(even[..., channel], lost, own, out=image[..., channel])
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_image: Tensor) -> tuple[Tensor, Tensor, None, None]:
        background, lit = ctx.saved_tensors
        v_even = torch.empty_like(v_image)
        for channel in range(3):
            torch.mul(v_image[..., channel], lit, out=v_even[..., channel])
        return v_even, (lit - 1) * (v_image @ (background + OFFSET)), None, None
