"""Rendering of the 3D branch: its transmitted and reflected light put together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.native.cuda.activations import Activation
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.ops.activations import activated, activated_vjp
from mgsr.ops.arrays import once_differentiable, plain
from mgsr.ops.gaussians import GaussianOptions, GaussianPass
from mgsr.ops.harmonics import check_degree, harmonics, harmonics_vjp
from mgsr.ops.lights import apply_shading, apply_shading_vjp, with_reflection, with_reflection_vjp
from mgsr.renderers.outputs import GaussianOutputs, camera_center

KINDS = (Activation.EXP, Activation.SIGMOID, Activation.SIGMOID, Activation.SIGMOID)


def render_gaussians(
    model: GaussianModel,
    camera: Camera,
    background: Tensor | None = None,
    degree: int | None = None,
    refl_degree: int | None = None,
    depth: bool = True,
    environment: Tensor | None = None,
    shading: Tensor | None = None,
) -> GaussianOutputs:
    """Render the Gaussians from any camera, at its size.

    background [3] colour behind them, black by default; degree and refl_degree: SH degrees of the transmitted and the
    reflected colours, by default all that is stored; depth: whether to render it; environment [H,W,3]: light that is
    added to the reflected colour (see `mgsr.renderers.environment_map`); shading [H,W]: the flash's shading of the
    transmitted colour (see `mgsr.ops.lights`); None is even light. Gradients flow to the model's tensors and to
    environment where these require them; none flow from `reflected` and `unlit`.

    Raises TensorError for a model with inconsistent tensors.
    """
    model.check()
    degree = model.sh_degree if degree is None else degree
    refl_degree = model.refl_sh_degree if refl_degree is None else refl_degree
    check_degree(model.sh, degree)
    if model.refl_sh is not None:
        check_degree(model.refl_sh, refl_degree)
    stored = (model.means, model.quats, model.log_scales, model.opacity_logits, model.sh)
    stored_split = (model.refl_opacity_logits, model.weight_logits, model.refl_sh)
    launcher = launcher_for(model.means)
    inputs = [tensor for tensor in (*stored, *stored_split, environment) if tensor is not None]
    differentiable = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs)
    rendering = _Rendering(
        GaussianPass(camera, GaussianOptions(low_pass=model.low_pass, depth=depth), launcher, differentiable),
        launcher,
        model.means.new_zeros(3) if background is None else plain(background),
        camera_center(camera),
        (degree, refl_degree),
        None if shading is None else plain(shading),
    )
    images = _RenderGaussians.apply(rendering, environment, *stored, *stored_split)
    color, transmitted, alpha, depths, own, weight, reflected, unlit = images
    if reflected is None:
        transmitted, weight = color, None
    elif own is None:
        weight = alpha
    return GaussianOutputs(
        color, transmitted, reflected, weight, depths, alpha, rendering.raster.stats, own, environment, unlit
    )


@dataclass
class _Rendering:
    """The inputs of a rendering beside the Gaussians; degrees: of the transmitted and the reflected colours."""

    raster: GaussianPass
    launcher: Launcher | None
    background: Tensor
    center: Tensor
    degrees: tuple[int, int]
    shading: Tensor | None


class _RenderGaussians(torch.autograd.Function):
    """The rendering from stored parameters to images, in one node.

    It covers activations, colours, rasterization, flash and reflected light.
    """

    @staticmethod
    def forward(
        ctx: Any, r: _Rendering, environment: Tensor | None, *stored: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        """Return the images [H,W] and [H,W,3] of stored parameters [N,...] and a reflected environment [H,W,3]."""
        tensors: list[Any] = [None if tensor is None else plain(tensor) for tensor in stored]
        means, quats, log_scales, opacity_logits, sh, refl_opacity_logits, weight_logits, refl_sh = tensors
        logits = [each for each in (opacity_logits, refl_opacity_logits, weight_logits) if each is not None]
        used = activated(r.launcher, KINDS[: 1 + len(logits)], (log_scales, *logits))
        rgb = harmonics(r.launcher, sh, means, r.center, r.degrees[0])
        split: tuple[Tensor | None, ...] = (None, None, None)
        if refl_sh is not None:
            split = (used[2], harmonics(r.launcher, refl_sh, means, r.center, r.degrees[1]), used[3])
        splats = (means, quats, *used[:2], rgb, *split, r.background)
        images = r.raster.forward(splats)
        unlit, alpha, depth, own, weight = images
        assert unlit is not None and alpha is not None
        transmitted = unlit if r.shading is None else apply_shading(r.launcher, unlit, alpha, r.background, r.shading)
        color, reflected = transmitted, None
        if own is not None or environment is not None:
            light = None if environment is None else plain(environment)
            by = alpha if weight is None else weight
            color, reflected = with_reflection(r.launcher, transmitted, by, own, light)
        ctx.rendering, ctx.images = r, len(images)
        ctx.save_for_backward(sh, refl_sh, reflected, *splats, *images)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(
            *(each for each in (reflected, None if r.shading is None else unlit) if each is not None)
        )
        apart = None if reflected is None else transmitted
        return color, apart, alpha, depth, own, weight, reflected, None if r.shading is None else unlit

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *v_outputs: Tensor | None) -> tuple[Tensor | None, ...]:
        """Return the gradients of the environment [H,W,3] and of the stored parameters [N,...]."""
        r, (sh, refl_sh, reflected, *saved) = ctx.rendering, ctx.saved_tensors
        splats, images = saved[: -ctx.images], saved[-ctx.images :]
        v_color, v_transmitted, v_alpha, v_depth, v_own, v_weight = (
            None if v is None else plain(v) for v in v_outputs[:6]
        )
        v_environment = None
        if reflected is None:
            v_transmitted = v_color
        elif v_color is not None:
            by, v_by = (images[1], v_alpha) if images[4] is None else (images[4], v_weight)
            before = (v_transmitted, v_by, v_own)
            v_transmitted, v_by, v_own, v_environment = with_reflection_vjp(r.launcher, v_color, reflected, by, before)
            v_alpha, v_weight = (v_by, None) if images[4] is None else (v_alpha, v_by)
            v_own = None if images[3] is None else v_own
        if r.shading is not None and v_transmitted is not None:
            v_transmitted, v_alpha = apply_shading_vjp(r.launcher, v_transmitted, r.background, r.shading, v_alpha)
        v_images = (v_transmitted, v_alpha, v_depth, v_own, v_weight)
        v_stored = _to_stored(r, sh, refl_sh, splats, r.raster.backward(splats, images, v_images))
        return None, v_environment if ctx.needs_input_grad[1] else None, *v_stored


def _to_stored(
    r: _Rendering, sh: Tensor, refl_sh: Tensor | None, splats: list[Any], v_splats: list[Any]
) -> tuple[Tensor | None, ...]:
    """Propagate the gradients of the rasterized splats [N,...] to the stored parameters."""
    means, _, scales, opacities, rgb, refl_opacities, refl_rgb, weights, _ = splats
    v_means, v_quats, v_scales, v_opacities, v_rgb, v_refl_opacities, v_refl_rgb, v_weights = v_splats
    v_sh = harmonics_vjp(r.launcher, sh, means, r.center, r.degrees[0], rgb, v_rgb, v_means)
    if refl_sh is None:
        v_geometry = activated_vjp(r.launcher, KINDS[:2], (scales, opacities), (v_scales, v_opacities))
        return v_means, v_quats, *v_geometry, v_sh, None, None, None
    v_refl_sh = harmonics_vjp(r.launcher, refl_sh, means, r.center, r.degrees[1], refl_rgb, v_refl_rgb, v_means)
    v_log_scales, *v_logits = activated_vjp(
        r.launcher,
        KINDS,
        (scales, opacities, refl_opacities, weights),
        (v_scales, v_opacities, v_refl_opacities, v_weights),
    )
    return v_means, v_quats, v_log_scales, v_logits[0], v_sh, *v_logits[1:], v_refl_sh
