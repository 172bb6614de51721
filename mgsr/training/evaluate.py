"""Renders during training: their PSNR for the curve and the convergence test, and previews for the user."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from mgsr.data.backdrop import Color
from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.renderers.both import render_both
from mgsr.renderers.surfels import render_surfels
from mgsr.training.views import TrainingView, color_tensor

# A branch's image [H,W,3] of a camera, on a background, shaded as `TrainingView.shading` says.
RenderFunction = Callable[[Camera, Color, Tensor | None], Tensor]


def surfel_picture(model: SurfelModel) -> RenderFunction:
    """Return a function that renders the 2D branch."""

    def picture(camera: Camera, background: Color, light: Tensor | None) -> Tensor:
        """Return the surfels' image [H,W,3] on a background colour, shaded by `light` [H,W] or None."""
        return render_surfels(model, camera, color_tensor(background, model.means.device), shading=light).color

    return picture


def gaussian_picture(model: TrainedModel) -> RenderFunction:
    """Return a function that renders the 3D branch, including the environment map's reflection in the surface.

    The 2D branch is rendered only where it is that surface.
    """
    drawn = model.for_gaussians()

    def picture(camera: Camera, background: Color, light: Tensor | None) -> Tensor:
        """Return the Gaussians' image [H,W,3] on a background colour, shaded by `light` [H,W] or None."""
        _, full = render_both(drawn, camera, color_tensor(background, model.device), depth=False, shading=light)
        assert full is not None
        return full.color

    return picture


@torch.no_grad()
def mean_psnr(picture: RenderFunction, views: list[TrainingView], background: Color) -> float:
    """Return the mean PSNR, dB, of a branch over views, with images clipped to 0..1.

    Only valid pixels count. background: the colour behind the splats, and behind photographs with masks.
    """
    values = []
    for view in views:
        image = picture(view.camera, background, view.shading()).clamp(0, 1)
        target = view.target(color_tensor(background, view.image.device))
        squares = (image - target.color_beside(image)).square()
        if target.invalid is not None:
            squares = squares[target.valid_weights(torch.ones_like(squares[..., 0])) > 0]
        error = float(squares.mean())
        values.append(-10 * math.log10(max(error, 1e-10)))
    return sum(values) / len(values)


@torch.no_grad()
def preview_pictures(model: TrainedModel, view: TrainingView, background: Color) -> dict[str, np.ndarray]:
    """Render pictures uint8 [H,W,3] of a view, before a background, by name.

    render: the image of the rendering branch, or of the only branch.
    normals: the surface's normals, with world axes as colours; grey off the surface.
    transmitted, reflected: the two halves of the light, where it is split.
    """
    color = color_tensor(background, model.device)
    flat, full = render_both(model, view.camera, color, depth=False, shading=view.shading())
    images: dict[str, Tensor] = {}
    if flat is not None:
        images = {"render": flat.color, "normals": flat.normal * 0.5 + 0.5}
    if full is not None:
        images["render"] = full.color
        if full.reflected is not None and full.weight is not None:
            images |= {"transmitted": full.transmitted, "reflected": full.weight[..., None] * full.reflected}
    return {name: (image.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy() for name, image in images.items()}
