"""Adds light to rendered images before they are compared: reflected light, and flash light.

Forward and backward functions work outside the graph, on contiguous tensors. launcher: of the GPU's kernels; None on
the CPU. On the CPU they go channel by channel, as torch broadcasts and sums an axis of length three several times more
slowly.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.lights import LightKernels
from mgsr.native.structs import UnlitGradients

# sRGB = (1 + OFFSET) light^(1/2.4) - OFFSET, away from black (IEC 61966-2-1).
OFFSET = 0.055


def apply_shading(
    launcher: Launcher | None, unlit: Tensor, alpha: Tensor, background: Tensor, shading: Tensor
) -> Tensor:
    """Return the image [H,W,3], in sRGB, of an object under a flash, from its image `unlit` [H,W,3] under even light.

    alpha [H,W]: of the object; background [3]. shading [H,W]: the flash's light, 0..1, to the power 1/2.4. It falls
    only on the object. Where the object is nearly black, the result may be below 0.
    """
    image = torch.empty_like(unlit)
    if launcher is not None:
        LightKernels(launcher).light_up(unlit, alpha, background, shading, OFFSET, image)
        return image
    lost = shading - 1
    for channel in range(3):
        # The object's light^(1/2.4) up to a factor: subtract the background, and add the offset.
        own = unlit[..., channel] + alpha * (background[channel] + OFFSET) - background[channel]
        torch.addcmul(unlit[..., channel], lost, own, out=image[..., channel])
    return image


def apply_shading_vjp(
    launcher: Launcher | None, v_image: Tensor, background: Tensor, shading: Tensor, v_alpha: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Return the gradients of unlit [H,W,3] and alpha [H,W], given that of the image, v_image [H,W,3].

    background [3]; shading [H,W]. v_alpha [H,W]: a gradient to add to that of alpha; None: 0.
    """
    v_unlit = torch.empty_like(v_image)
    if launcher is not None:
        total = torch.empty_like(shading)
        out = UnlitGradients(v_unlit=v_unlit, v_alpha=total)
        LightKernels(launcher).light_up_vjp(v_image, background, shading, OFFSET, v_alpha, out)
        return v_unlit, total
    for channel in range(3):
        torch.mul(v_image[..., channel], shading, out=v_unlit[..., channel])
    own = (shading - 1) * (v_image @ (background + OFFSET))
    return v_unlit, own if v_alpha is None else own + v_alpha


def with_reflection(
    launcher: Launcher | None, transmitted: Tensor, weight: Tensor, own: Tensor | None, environment: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Return the image C_3D [H,W,3] = transmitted + weight * reflected, and reflected [H,W,3] = own + environment.

    weight [H,W]; transmitted, own, environment [H,W,3]. One of own and environment may be None.
    """
    if launcher is not None:
        color, reflected = torch.empty_like(transmitted), torch.empty_like(transmitted)
        LightKernels(launcher).add_reflection(transmitted, weight, own, environment, color, reflected)
        return color, reflected
    parts = [each for each in (own, environment) if each is not None]
    reflected = parts[0] + parts[1] if len(parts) == 2 else parts[0].detach()  # a new tensor for the graph
    color = torch.empty_like(transmitted)
    for channel in range(3):
        torch.addcmul(transmitted[..., channel], weight, reflected[..., channel], out=color[..., channel])
    return color, reflected


def with_reflection_vjp(
    launcher: Launcher | None,
    v_color: Tensor,
    reflected: Tensor,
    weight: Tensor,
    before: tuple[Tensor | None, Tensor | None, Tensor | None],
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the gradients of transmitted, weight, own and environment, given that of the image, v_color [H,W,3].

    reflected [H,W,3] and weight [H,W]: as in `with_reflection`. before: gradients to add to the first three.
    """
    if launcher is not None:
        v_transmitted, v_own, v_environment = (torch.empty_like(v_color) for _ in range(3))
        v_weight = torch.empty_like(weight)
        out = (v_transmitted, v_weight, v_own, v_environment)
        LightKernels(launcher).add_reflection_vjp(v_color, reflected, weight, before, out)
        return out
    v_environment = torch.empty_like(v_color)
    for channel in range(3):
        torch.mul(v_color[..., channel], weight, out=v_environment[..., channel])
    own = (v_color, (v_color * reflected) @ torch.ones(3), v_environment)
    v_transmitted, v_weight, v_own = (
        each if added is None else each + added for each, added in zip(own, before, strict=True)
    )
    return v_transmitted, v_weight, v_own, v_environment
