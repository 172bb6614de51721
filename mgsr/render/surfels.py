"""Renders the 2D branch."""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.ops.surfels import SurfelOptions, rasterize_surfels
from mgsr.render.outputs import SurfelOutputs, camera_center


def render_surfels(
    model: SurfelModel,
    camera: Camera,
    background: Tensor | None = None,
    degree: int | None = None,
    distortion: bool = False,
) -> SurfelOutputs:
    """The surfels seen by any camera, at its size.

    background [3] colour behind them, black by default; degree: SH degree of the colours, by default all that is
    stored. Gradients flow to the model's tensors where these ask for them.
    """
    center = camera_center(camera, model.means.device)
    raster = rasterize_surfels(
        model.means,
        model.quats,
        model.scales(),
        model.opacities(),
        model.colors(center, degree),
        camera,
        torch.zeros(3, device=model.means.device) if background is None else background,
        options=SurfelOptions(distortion=distortion),
    )
    return SurfelOutputs(
        raster.color,
        raster.alpha,
        raster.depth,
        raster.median_depth,
        raster.normal,
        raster.distortion,
        raster.stats,
    )
