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
from mgsr.native.structs import (
    GaussianGradients,
    GaussianImageGradients,
    GaussianImages,
    GaussianSplats,
    Harmonics,
)
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

    background [3]: colour behind the Gaussians; black by default.
    degree, refl_degree: SH degrees of the transmitted and the reflected colours; by default, all that are stored.
    depth: whether to render depth.
    environment [H,W,3]: light added to the reflected colour (see `mgsr.renderers.environment_map`).
    shading [H,W]: the flash's shading of the transmitted colour (see `mgsr.ops.lights`); None is even light.

    Gradients flow to the model's tensors and to `environment` if these require them, but not from `reflected` and
    `unlit`.

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
    rendering = _GaussianInputs(
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
class _GaussianInputs:
    """The inputs of a rendering beside the Gaussians; degrees: of the transmitted and the reflected colours."""

    raster: GaussianPass
    launcher: Launcher | None
    background: Tensor
    center: Tensor
    degrees: tuple[int, int]
    shading: Tensor | None

    def transmitted(self, sh: Tensor, means: Tensor) -> Harmonics:
        """Return the transmitted colours of Gaussians at means [N,3], from their coefficients sh [N,K,3]."""
        return Harmonics(coeffs=sh, means=means, center=self.center, degree=self.degrees[0])

    def reflected(self, sh: Tensor, means: Tensor) -> Harmonics:
        """Return the reflected colours of Gaussians at means [N,3], from their coefficients sh [N,K,3]."""
        return Harmonics(coeffs=sh, means=means, center=self.center, degree=self.degrees[1])


class _RenderGaussians(torch.autograd.Function):
    """The rendering from stored parameters to images, in one node.

    It covers activations, colours, rasterization, flash and reflected light.
    """

    @staticmethod
    def forward(
        ctx: Any, r: _GaussianInputs, environment: Tensor | None, *stored: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        """Return the images [H,W] and [H,W,3] of stored parameters [N,...] and a reflected environment [H,W,3]."""
        tensors: list[Any] = [None if tensor is None else plain(tensor) for tensor in stored]
        means, quats, log_scales, opacity_logits, sh, refl_opacity_logits, weight_logits, refl_sh = tensors
        logits = [each for each in (opacity_logits, refl_opacity_logits, weight_logits) if each is not None]
        used = activated(r.launcher, KINDS[: 1 + len(logits)], (log_scales, *logits))
        refl_rgb = None if refl_sh is None else harmonics(r.launcher, r.reflected(refl_sh, means))
        splats = GaussianSplats(
            means=means,
            quats=quats,
            scales=used[0],
            opacities=used[1],
            colors=harmonics(r.launcher, r.transmitted(sh, means)),
            refl_opacities=None if refl_sh is None else used[2],
            refl_colors=refl_rgb,
            weights=None if refl_sh is None else used[3],
            background=r.background,
        )
        images = r.raster.forward(splats)
        unlit, alpha, depth, own, weight = images
        transmitted = unlit if r.shading is None else apply_shading(r.launcher, unlit, alpha, r.background, r.shading)
        color, reflected = transmitted, None
        if own is not None or environment is not None:
            light = None if environment is None else plain(environment)
            by = alpha if weight is None else weight
            color, reflected = with_reflection(r.launcher, transmitted, by, own, light)
        ctx.rendering = r
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
        count = len(GaussianSplats._fields)
        splats, images = GaussianSplats._make(saved[:count]), GaussianImages._make(saved[count:])
        v_color, v_transmitted, v_alpha, v_depth, v_own, v_weight = (
            None if v is None else plain(v) for v in v_outputs[:6]
        )
        v_environment = None
        if reflected is None:
            v_transmitted = v_color
        elif v_color is not None:
            by, v_by = (images.alpha, v_alpha) if images.weight is None else (images.weight, v_weight)
            before = (v_transmitted, v_by, v_own)
            v_transmitted, v_by, v_own, v_environment = with_reflection_vjp(r.launcher, v_color, reflected, by, before)
            v_alpha, v_weight = (v_by, None) if images.weight is None else (v_alpha, v_by)
            v_own = None if images.reflected is None else v_own
        if r.shading is not None and v_transmitted is not None:
            v_transmitted, v_alpha = apply_shading_vjp(r.launcher, v_transmitted, r.background, r.shading, v_alpha)
        v_images = GaussianImageGradients(
            color=v_transmitted, alpha=v_alpha, depth=v_depth, reflected=v_own, weight=v_weight
        )
        v_stored = _to_stored(r, sh, refl_sh, splats, r.raster.backward(splats, images, v_images))
        return None, v_environment if ctx.needs_input_grad[1] else None, *v_stored


def _to_stored(
    r: _GaussianInputs, sh: Tensor, refl_sh: Tensor | None, splats: GaussianSplats, v: GaussianGradients
) -> tuple[Tensor | None, ...]:
    """Propagate the gradients of the rasterized splats [N,...] to the stored parameters."""
    v_sh = harmonics_vjp(r.launcher, r.transmitted(sh, splats.means), splats.colors, v.colors, v.means)
    if refl_sh is None:
        used, v_used = (splats.scales, splats.opacities), (v.scales, v.opacities)
        return v.means, v.quats, *activated_vjp(r.launcher, KINDS[:2], used, v_used), v_sh, None, None, None
    assert splats.refl_opacities is not None and splats.refl_colors is not None and splats.weights is not None
    assert v.refl_colors is not None
    v_refl_sh = harmonics_vjp(
        r.launcher, r.reflected(refl_sh, splats.means), splats.refl_colors, v.refl_colors, v.means
    )
    v_log_scales, *v_logits = activated_vjp(
        r.launcher,
        KINDS,
        (splats.scales, splats.opacities, splats.refl_opacities, splats.weights),
        (v.scales, v.opacities, v.refl_opacities, v.weights),
    )
    return v.means, v.quats, v_log_scales, v_logits[0], v_sh, *v_logits[1:], v_refl_sh
