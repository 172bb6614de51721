"""Renders the 2D branch."""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.ops.lights import light_up
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from mgsr.render.outputs import SurfelOutputs, camera_center


def render_surfels(
    model: SurfelModel,
    camera: Camera,
    background: Tensor | None = None,
    degree: int | None = None,
    distortion: bool = False,
    lit: Tensor | None = None,
) -> SurfelOutputs:
    """The surfels seen by any camera, at its size.

    background [3] colour behind them, black by default; degree: SH degree of the colours, by default all that is
    stored; lit [H,W]: what a flash makes of the colour (see `mgsr.ops.lights`), which without it is that under even
    light. Gradients flow to the model's tensors where these ask for them.
    """
    center = camera_center(camera)
    behind = torch.zeros(3, device=model.means.device) if background is None else background
    scales, opacities = model.activated()
    raster = rasterize_surfels(
        model.means,
        model.quats,
        scales,
        opacities,
        model.colors(center, degree),
        camera,
        behind,
        options=SurfelOptions(distortion=distortion),
    )
    color = raster.color if lit is None else light_up(raster.color, raster.alpha, behind, lit)
    return SurfelOutputs(
        color,
        raster.alpha,
        raster.depth,
        raster.median_depth,
        raster.normal,
        raster.distortion,
        raster.stats,
        None if lit is None else raster.color,
    )
