"""The PSNR of a branch on views, for the curve and the convergence test."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from mgsr.data.backdrop import Color
from mgsr.data.camera import Camera
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.renderers.both import render_both
from mgsr.renderers.surfels import render_surfels
from mgsr.training.views import TrainingView, color_tensor

# A branch's image [H,W,3] of a camera, on a background, lit as `TrainingView.light` says.
Picture = Callable[[Camera, Color, Tensor | None], Tensor]


def surfel_picture(model: SurfelModel) -> Picture:
    """Return a function that renders the 2D branch."""

    def picture(camera: Camera, background: Color, light: Tensor | None) -> Tensor:
        return render_surfels(model, camera, color_tensor(background, model.means.device), lit=light).color

    return picture


def volume_picture(model: VolumeModel, surfels: SurfelModel | None, mirrored: MirroredLight | None) -> Picture:
    """Return a function that renders the 3D branch, with what the surface mirrors."""

    def picture(camera: Camera, background: Color, light: Tensor | None) -> Tensor:
        color = color_tensor(background, model.means.device)
        mirror = surfels if mirrored is not None and mirrored.reflector is None else None
        _, full = render_both(mirror, model, mirrored, camera, color, depth=False, lit=light)
        assert full is not None
        return full.color

    return picture


@torch.no_grad()
def mean_psnr(picture: Picture, views: list[TrainingView], background: Color) -> float:
    """Return the mean PSNR, dB, of a branch over views, with images clipped to 0..1.

    Only pixels that the photographs show count. background: the colour behind the splats and the photographs with
    masks.
    """
    values = []
    for view in views:
        image = picture(view.camera, background, view.light()).clamp(0, 1)
        target = view.target(color_tensor(background, view.image.device))
        squares = (image - target.color).square()
        if target.unknown is not None:
            squares = squares[target.known(torch.ones_like(squares[..., 0])) > 0]
        error = float(squares.mean())
        values.append(-10 * math.log10(max(error, 1e-10)))
    return sum(values) / len(values)
