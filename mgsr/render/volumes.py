"""Renders the 3D branch and puts its two lights together."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from mgsr.data.camera import Camera
from mgsr.gaussians.volumes import VolumeModel
from mgsr.ops.volumes import Reflected, VolumeOptions, rasterize_volumes
from mgsr.render.lit import light_up
from mgsr.render.outputs import VolumeOutputs, camera_center


def render_volumes(
    model: VolumeModel,
    camera: Camera,
    background: Tensor | None = None,
    degree: int | None = None,
    refl_degree: int | None = None,
    depth: bool = True,
    mirrored: Tensor | None = None,
    lit: Tensor | None = None,
) -> VolumeOutputs:
    """The Gaussians seen by any camera, at its size.

    background [3] colour behind them, black by default; degree and refl_degree: SH degrees of the transmitted and
    the reflected colours, by default all that is stored; depth: off saves its time; mirrored [H,W,3]: light that is
    added to the reflected colour (see `mgsr.render.mirrored`); lit [H,W]: what a flash makes of the transmitted colour
    (see `mgsr.render.lit`), which without it is that under even light. Gradients flow to the model's tensors, and to
    the mirrored light, where these ask for them.
    """
    center = camera_center(camera, model.means.device)
    behind = torch.zeros(3, device=model.means.device) if background is None else background
    raster = rasterize_volumes(
        model.means,
        model.quats,
        model.scales(),
        model.opacities(),
        model.colors(center, degree),
        camera,
        behind,
        reflected=_reflected(model, center, refl_degree),
        options=VolumeOptions(low_pass=model.low_pass, depth=depth),
    )
    transmitted = raster.color if lit is None else light_up(raster.color, raster.alpha, behind, lit)
    color, reflected, weight = transmitted, mirrored, raster.alpha
    if raster.reflected is not None and raster.weight is not None:
        reflected, weight = raster.reflected if mirrored is None else raster.reflected + mirrored, raster.weight
    if reflected is not None:
        color = add_reflection(transmitted, reflected, weight)
    lights = (color, transmitted, reflected, None if reflected is None else weight)
    even = None if lit is None else raster.color
    return VolumeOutputs(*lights, raster.depth, raster.alpha, raster.stats, mirrored, even)


def add_reflection(transmitted: Tensor, reflected: Tensor, weight: Tensor) -> Tensor:
    """transmitted [H,W,3] + weight [H,W] * reflected [H,W,3]: the image C_3D, with gradients to all three."""
    color: Tensor = _AddReflection.apply(transmitted, reflected, weight)
    return color


def _reflected(model: VolumeModel, center: Tensor, degree: int | None) -> Reflected | None:
    if not model.split:
        return None
    return Reflected(model.refl_opacities(), model.refl_colors(center, degree), model.weights())


class _AddReflection(torch.autograd.Function):
    """Channel by channel: torch's broadcast over, and sum along, an axis of three is several times slower."""

    @staticmethod
    def forward(ctx: Any, transmitted: Tensor, reflected: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(reflected, weight)
        color = torch.empty_like(transmitted)
        for channel in range(3):
            torch.addcmul(transmitted[..., channel], weight, reflected[..., channel], out=color[..., channel])
        return color

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_color: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        reflected, weight = ctx.saved_tensors
        v_reflected = torch.empty_like(reflected)
        for channel in range(3):
            torch.mul(v_color[..., channel], weight, out=v_reflected[..., channel])
        return v_color, v_reflected, (v_color * reflected) @ torch.ones(3, device=v_color.device)
