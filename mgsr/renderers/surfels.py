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

    background [3] colour behind them, black by default; degree: SH degree of the colours, by default all that is
    stored; shading [H,W]: the flash's shading of the colour (see `mgsr.ops.lights`); None is even light. Gradients flow
    to the model's tensors where these ask for them.

    Raises TensorError for a model with inconsistent tensors.
    """
    model.check()
    degree = model.sh_degree if degree is None else degree
    check_degree(model.sh, degree)
    stored = (model.means, model.quats, model.log_scales, model.opacity_logits, model.sh)
    launcher = launcher_for(model.means)
    differentiable = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in stored)
    rendering = _Rendering(
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
class _Rendering:
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
    def forward(ctx: Any, r: _Rendering, *stored: Tensor) -> tuple[Tensor | None, ...]:
        """Return the images [H,W] and [H,W,3] of stored parameters [N,...]."""
        means, quats, log_scales, opacity_logits, sh = (plain(tensor) for tensor in stored)
        scales, opacities = activated(r.launcher, KINDS, (log_scales, opacity_logits))
        rgb = harmonics(r.launcher, sh, means, r.center, r.degree)
        splats = (means, quats, scales, opacities, rgb, r.background)
        images = r.raster.forward(splats)
        color, alpha, unlit = images[0], images[1], None
        assert color is not None and alpha is not None
        if r.shading is not None:
            unlit, color = color, apply_shading(r.launcher, color, alpha, r.background, r.shading)
        ctx.rendering, ctx.images = r, len(images)
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
        splats, images = saved[: -ctx.images], saved[-ctx.images :]
        v_images = [None if v is None else plain(v) for v in v_outputs[:-1]]
        if r.shading is not None and v_images[0] is not None:
            v_images[:2] = apply_shading_vjp(r.launcher, v_images[0], r.background, r.shading, v_images[1])
        v_means, v_quats, v_scales, v_opacities, v_rgb = r.raster.backward(splats, images, v_images)
        means, _, scales, opacities, rgb, _ = splats
        v_sh = harmonics_vjp(r.launcher, sh, means, r.center, r.degree, rgb, v_rgb, v_means)
        v_stored = activated_vjp(r.launcher, KINDS, (scales, opacities), (v_scales, v_opacities))
        return None, v_means, v_quats, *v_stored, v_sh
