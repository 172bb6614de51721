"""Adds light to rendered images before they are compared: reflected light, and flash light.

Forward and backward functions work outside the graph, on contiguous tensors. launcher: of the GPU's kernels; None on
the CPU.
"""

from __future__ import annotations

from types import ModuleType

import torch
from torch import Tensor

from mgsr.native import _lights
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
    _kernels(launcher).light_up(unlit, alpha, background, shading, OFFSET, image)
    return image


def apply_shading_vjp(
    launcher: Launcher | None, v_image: Tensor, background: Tensor, shading: Tensor, v_alpha: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Return the gradients of unlit [H,W,3] and alpha [H,W], given that of the image, v_image [H,W,3].

    background [3]; shading [H,W]. v_alpha [H,W]: a gradient to add to that of alpha; None: 0.
    """
    out = UnlitGradients(v_unlit=torch.empty_like(v_image), v_alpha=torch.empty_like(shading))
    _kernels(launcher).light_up_vjp(v_image, background, shading, OFFSET, v_alpha, out)
    return out.v_unlit, out.v_alpha


def with_reflection(
    launcher: Launcher | None, transmitted: Tensor, weight: Tensor, own: Tensor | None, environment: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Return the image C_3D [H,W,3] = transmitted + weight * reflected, and reflected [H,W,3] = own + environment.

    weight [H,W]; transmitted, own, environment [H,W,3]. One of own and environment may be None.
    """
    color, reflected = torch.empty_like(transmitted), torch.empty_like(transmitted)
    _kernels(launcher).add_reflection(transmitted, weight, own, environment, color, reflected)
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
    v_transmitted, v_own, v_environment = (torch.empty_like(v_color) for _ in range(3))
    out = (v_transmitted, torch.empty_like(weight), v_own, v_environment)
    _kernels(launcher).add_reflection_vjp(v_color, reflected, weight, before, out)
    return out


def _kernels(launcher: Launcher | None) -> LightKernels | ModuleType:
    """Return the kernels on a launcher, or those of the CPU."""
    return _lights if launcher is None else LightKernels(launcher)
