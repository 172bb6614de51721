"""Renders the 3D branch and puts its two lights together."""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.volumes import VolumeModel
from mgsr.ops.lights import add_reflection, light_up
from mgsr.ops.volumes import Reflected, VolumeOptions, rasterize_volumes
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
    (see `mgsr.ops.lights`), which without it is that under even light. Gradients flow to the model's tensors, and to
    the mirrored light, where these ask for them.
    """
    center = camera_center(camera)
    behind = torch.zeros(3, device=model.means.device) if background is None else background
    scales, opacities, refl_opacities, weights = model.activated()
    reflected_half = None
    if refl_opacities is not None and weights is not None:
        reflected_half = Reflected(refl_opacities, model.refl_colors(center, refl_degree), weights)
    raster = rasterize_volumes(
        model.means,
        model.quats,
        scales,
        opacities,
        model.colors(center, degree),
        camera,
        behind,
        reflected=reflected_half,
        options=VolumeOptions(low_pass=model.low_pass, depth=depth),
    )
    transmitted = raster.color if lit is None else light_up(raster.color, raster.alpha, behind, lit)
    weight = raster.alpha if raster.weight is None else raster.weight
    color, reflected = transmitted, None
    if raster.reflected is not None or mirrored is not None:
        color, reflected = add_reflection(transmitted, weight, raster.reflected, mirrored)
    return VolumeOutputs(
        color,
        transmitted,
        reflected,
        None if reflected is None else weight,
        raster.depth,
        raster.alpha,
        raster.stats,
        raster.reflected,
        mirrored,
        None if lit is None else raster.color,
    )
