"""What is made of rendered images before they are compared: reflected light added, and a flash let fall on them."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from mgsr.checks import check_tensors
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.lights import LightKernels
from mgsr.ops.arrays import plain

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
    """On the processor channel by channel: torch's broadcast over, and sum along, an axis of three is several times
    slower."""

    @staticmethod
    def forward(ctx: Any, even: Tensor, alpha: Tensor, background: Tensor, lit: Tensor) -> Tensor:
        launcher = launcher_for(even)
        ctx.kernels = None if launcher is None else LightKernels(launcher)
        ctx.save_for_backward(background, lit)
        image = torch.empty_like(even)
        if ctx.kernels is not None:
            ctx.kernels.light_up(*(plain(each) for each in (even, alpha, background, lit)), OFFSET, image)
            return image
        lost = lit - 1
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
        if ctx.kernels is not None:
            v_alpha = torch.empty_like(lit)
            ctx.kernels.light_up_vjp(*(plain(each) for each in (v_image, background, lit)), OFFSET, v_even, v_alpha)
            return v_even, v_alpha, None, None
        for channel in range(3):
            torch.mul(v_image[..., channel], lit, out=v_even[..., channel])
        return v_even, (lit - 1) * (v_image @ (background + OFFSET)), None, None


def add_reflection(
    transmitted: Tensor, weight: Tensor, own: Tensor | None, mirrored: Tensor | None
) -> tuple[Tensor, Tensor]:
    """The image C_3D [H,W,3] = transmitted + weight * reflected, and reflected [H,W,3] = own + mirrored.

    transmitted, own and mirrored [H,W,3]; weight [H,W]. Of own and mirrored one may be None. Gradients flow from the
    image to all, and from reflected to none. Raises TensorError for wrong shapes or dtypes.
    """
    sizes = check_tensors(transmitted=(transmitted, "H W 3"), weight=(weight, "H W"))
    for name, light in (("own", own), ("mirrored", mirrored)):
        if light is not None:
            check_tensors(sizes, **{"transmitted": (transmitted, "H W 3"), name: (light, "H W 3")})
    color, reflected = _AddReflection.apply(transmitted, weight, own, mirrored)
    return color, reflected


class _AddReflection(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, transmitted: Tensor, weight: Tensor, own: Tensor | None, mirrored: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        launcher = launcher_for(transmitted)
        ctx.kernels = None if launcher is None else LightKernels(launcher)
        one, other = (None if each is None else plain(each) for each in (own, mirrored))
        if ctx.kernels is None:
            color, reflected = _add(plain(transmitted), plain(weight), one, other)
        else:
            color, reflected = torch.empty_like(transmitted), torch.empty_like(transmitted)
            ctx.kernels.add_reflection(plain(transmitted), plain(weight), one, other, color, reflected)
        ctx.save_for_backward(reflected, weight)
        ctx.mark_non_differentiable(reflected)
        return color, reflected

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_color: Tensor, _: Tensor) -> tuple[Tensor, Tensor, Tensor | None, Tensor | None]:
        reflected, weight = ctx.saved_tensors
        v_color = plain(v_color)
        v_reflected, v_weight = torch.empty_like(v_color), torch.empty_like(weight)
        if ctx.kernels is None:
            for channel in range(3):
                torch.mul(v_color[..., channel], weight, out=v_reflected[..., channel])
            v_weight = (v_color * reflected) @ torch.ones(3)
        else:
            ctx.kernels.add_reflection_vjp(v_color, reflected, weight, v_reflected, v_weight)
        of_own, of_mirrored = ctx.needs_input_grad[2:]
        return v_color, v_weight, v_reflected if of_own else None, v_reflected if of_mirrored else None


def _add(transmitted: Tensor, weight: Tensor, own: Tensor | None, mirrored: Tensor | None) -> tuple[Tensor, Tensor]:
    """Channel by channel: torch's broadcast over, and sum along, an axis of three is several times slower."""
    parts = [each for each in (own, mirrored) if each is not None]
    reflected = parts[0] + parts[1] if len(parts) == 2 else parts[0]
    color = torch.empty_like(transmitted)
    for channel in range(3):
        torch.addcmul(transmitted[..., channel], weight, reflected[..., channel], out=color[..., channel])
    return color, reflected
