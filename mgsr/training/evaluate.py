"""How well a branch renders views, for the curve and the convergence test."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.render.surfels import render_surfels
from mgsr.render.volumes import render_volumes
from mgsr.training.views import Color, TrainingView, color_tensor


@torch.no_grad()
def render_color(model: SurfelModel | VolumeModel, view: TrainingView, background: Color) -> Tensor:
    """The branch's image [H,W,3] of a view's camera, without gradients."""
    color = color_tensor(background, model.means.device)
    if isinstance(model, SurfelModel):
        return render_surfels(model, view.camera, color).color
    return render_volumes(model, view.camera, color, depth=False).color


def mean_psnr(model: SurfelModel | VolumeModel, views: list[TrainingView], background: Color) -> float:
    """The mean over the views of the PSNR, dB, of images clipped to 0..1, on `background` where there are masks."""
    values = []
    for view in views:
        image = render_color(model, view, background).clamp(0, 1)
        error = float((image - view.target(background).color).square().mean())
        values.append(-10 * math.log10(max(error, 1e-10)))
    return sum(values) / len(values)
