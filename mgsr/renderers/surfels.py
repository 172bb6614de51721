"""Rendering of the 2D branch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.native.cuda.activations import Activation
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.native.structs import Harmonics, SurfelImageGradients, SurfelImages, SurfelSplats
from mgsr.ops.activations import activated, activated_vjp
from mgsr.ops.arrays import once_differentiable, plain
from mgsr.ops.harmonics import check_degree, harmonics, harmonics_vjp
from mgsr.ops.lights import apply_shading, apply_shading_vjp
from mgsr.ops.surfels import SurfelOptions, SurfelPass
from mgsr.renderers.outputs import SurfelOutputs, camera_center

KINDS = (Activation.EXP, Activation.SIGMOID)


def render_surfels(
    model: SurfelModel,
    camera: Camera,
    background: Tensor | None = None,
    degree: int | None = None,
    distortion: bool = False,
    shading: Tensor | None = None,
) -> SurfelOutputs:
    """Render the surfels from any camera, at its size.

    background [3]: the colour behind the surfels, black by default. degree: the SH degree of the colours, by default
    the stored one. shading [H,W]: the flash's shading of the colour (see `mgsr.ops.lights`); None is even light.
    Gradients flow to the model's tensors, if these require them.

    Raises TensorError for a model with inconsistent tensors.
    """
    model.check()
    degree = model.sh_degree if degree is None else degree
    check_degree(model.sh, degree)
    stored = (model.means, model.quats, model.log_scales, model.opacity_logits, model.sh)
    launcher = launcher_for(model.means)
    differentiable = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in stored)
    rendering = _SurfelInputs(
        SurfelPass(camera, SurfelOptions(distortion=distortion), launcher, differentiable),
        launcher,
        model.means.new_zeros(3) if background is None else plain(background),
        camera_center(camera),
        degree,
        None if shading is None else plain(shading),
    )
    color, alpha, depth, median_depth, normal, distorted, unlit = _RenderSurfels.apply(rendering, *stored)
    return SurfelOutputs(color, alpha, depth, median_depth, normal, distorted, rendering.raster.stats, unlit)


@dataclass
class _SurfelInputs:
    """The inputs of a rendering beside the surfels."""

    raster: SurfelPass
    launcher: Launcher | None
    background: Tensor
    center: Tensor
    degree: int
    shading: Tensor | None


class _RenderSurfels(torch.autograd.Function):
    """The rendering from stored parameters to images, in one node.

    It covers activations, colours, rasterization and flash.
    """

    @staticmethod
    def forward(ctx: Any, r: _SurfelInputs, *stored: Tensor) -> tuple[Tensor | None, ...]:
        """Return the images [H,W] and [H,W,3] of stored parameters [N,...]."""
        means, quats, log_scales, opacity_logits, sh = (plain(tensor) for tensor in stored)
        scales, opacities = activated(r.launcher, KINDS, (log_scales, opacity_logits))
        rgb = harmonics(r.launcher, Harmonics(coeffs=sh, means=means, center=r.center, degree=r.degree))
        splats = SurfelSplats(
            means=means, quats=quats, scales=scales, opacities=opacities, colors=rgb, background=r.background
        )
        images = r.raster.forward(splats)
        color, unlit = images.color, None
        if r.shading is not None:
            unlit, color = color, apply_shading(r.launcher, color, images.alpha, r.background, r.shading)
        ctx.rendering = r
        ctx.save_for_backward(sh, *splats, *images)
        ctx.set_materialize_grads(False)
        if unlit is not None:
            ctx.mark_non_differentiable(unlit)
        return color, *images[1:], unlit

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *v_outputs: Tensor | None) -> tuple[Tensor | None, ...]:
        """Return the gradients of the stored parameters [N,...]."""
        r, (sh, *saved) = ctx.rendering, ctx.saved_tensors
        count = len(SurfelSplats._fields)
        splats, images = SurfelSplats._make(saved[:count]), SurfelImages._make(saved[count:])
        v_images = SurfelImageGradients._make(None if v is None else plain(v) for v in v_outputs[:-1])
        if r.shading is not None and v_images.color is not None:
            v_color, v_alpha = apply_shading_vjp(r.launcher, v_images.color, r.background, r.shading, v_images.alpha)
            v_images = v_images._replace(color=v_color, alpha=v_alpha)
        v = r.raster.backward(splats, images, v_images)
        colored = Harmonics(coeffs=sh, means=splats.means, center=r.center, degree=r.degree)
        v_sh = harmonics_vjp(r.launcher, colored, splats.colors, v.colors, v.means)
        v_stored = activated_vjp(r.launcher, KINDS, (splats.scales, splats.opacities), (v.scales, v.opacities))
        return None, v.means, v.quats, *v_stored, v_sh
