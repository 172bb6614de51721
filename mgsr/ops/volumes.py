"""Rasterize 3D Gaussians: one opacity, or a transmitted and a reflected one over the same footprint."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.data.camera import Camera
from mgsr.native import _volumes
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.volumes import VolumeKernels


class Reflected(NamedTuple):
    """The reflected part of each Gaussian: opacities [N] in [0,1], colors [N,3], weights [N] (beta)."""

    opacities: Tensor
    colors: Tensor
    weights: Tensor


@dataclass(frozen=True)
class VolumeOptions:
    """near: camera units, splats nearer are left out; low_pass: px^2 added to each projected covariance;
    compensate: lower the opacity by what the low-pass adds, so that zooming out keeps the energy; depth: whether
    to render depth."""

    near: float = 0.01
    low_pass: float = 0.3
    compensate: bool = False
    depth: bool = True


@dataclass
class SplatStats:
    """Per-splat facts of one render: radii [N] pixels (0 where culled), and, once backward has run, v_means2d
    [N,2], the gradient of the loss to each projected centre in pixels."""

    radii: Tensor
    v_means2d: Tensor | None = field(default=None)

    @property
    def visible(self) -> Tensor:
        """Which splats were not culled, [N] bool."""
        return self.radii > 0


@dataclass(frozen=True)
class VolumeRaster:
    """color [H,W,3]: transmitted light over the background; alpha [H,W]: 1 - transmittance; depth [H,W]: mean
    camera z, 0 where nothing is, or None; reflected [H,W,3] and weight [H,W]: None for single opacity."""

    color: Tensor
    alpha: Tensor
    depth: Tensor | None
    reflected: Tensor | None
    weight: Tensor | None
    stats: SplatStats


def rasterize_volumes(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    background: Tensor,
    reflected: Reflected | None = None,
    options: VolumeOptions | None = None,
) -> VolumeRaster:
    """Blend Gaussians front to back into images; gradients flow to all splat tensors.

    means [N,3] world; quats [N,4] wxyz, any length but zero; scales [N,3] world units, linear; opacities [N] in
    [0,1]; colors [N,3]; background [3]. A splat with a non-finite value is left out. alpha =
    min(0.999, opacity * G) counts from 1/255; a pixel stops before the splat that would leave a transmittance under
    1e-4 (for each of the two opacities on its own).

    Raises TensorError for a wrong shape or dtype. Source: supplement, Eq. 16-19; method.md "3D branch".
    """
    options = options or VolumeOptions()
    sizes = check_tensors(
        means=(means, "N 3"),
        quats=(quats, "N 4"),
        scales=(scales, "N 3"),
        opacities=(opacities, "N"),
        colors=(colors, "N 3"),
        background=(background, "3"),
    )
    if reflected is not None:
        check_tensors(
            sizes,
            means=(means, "N 3"),
            refl_opacities=(reflected.opacities, "N"),
            refl_colors=(reflected.colors, "N 3"),
            weights=(reflected.weights, "N"),
        )
    stats = SplatStats(radii=means.new_empty(len(means)))
    tensors = (means, quats, scales, opacities, colors, *(reflected or (None, None, None)), background)
    launcher = launcher_for(means)
    differentiable = torch.is_grad_enabled() and any(t is not None and t.requires_grad for t in tensors)
    kernels = _volumes if launcher is None else VolumeKernels(launcher, keep=differentiable)
    color, alpha, depth, refl, weight = _Rasterize.apply(*tensors, camera, options, stats, kernels)
    return VolumeRaster(color, alpha, depth, refl, weight, stats)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means,
        quats,
        scales,
        opacities,
        colors,
        refl_opacities,
        refl_colors,
        weights,
        background,
        camera,
        options,
        stats,
        kernels,
    ):
        splats = [
            t if t is None else t.detach().contiguous()
            for t in (means, quats, scales, opacities, colors, refl_opacities, refl_colors, weights, background)
        ]
        height, width = camera.height, camera.width
        dual = refl_opacities is not None
        color, alpha = means.new_empty(height, width, 3), means.new_empty(height, width)
        depth = means.new_empty(height, width) if options.depth else None
        refl = means.new_empty(height, width, 3) if dual else None
        weight = means.new_empty(height, width) if dual else None
        view = (
            np.ascontiguousarray(camera.K, dtype=np.float64),
            np.ascontiguousarray(camera.cam_from_world, dtype=np.float64),
            width,
            height,
            options.near,
            options.low_pass,
            options.compensate,
        )
        ctx.frame = kernels.forward(*splats, *view, color, alpha, depth, refl, weight, stats.radii)
        ctx.splats, ctx.view, ctx.stats, ctx.kernels = splats, view, stats, kernels
        ctx.save_for_backward(color, alpha, depth, refl, weight)
        ctx.set_materialize_grads(False)
        return color, alpha, depth, refl, weight

    @staticmethod
    def backward(ctx: Any, *v_outputs: Any):
        images: list[Any] = [t if t is None else t.detach() for t in ctx.saved_tensors]
        v_images: list[Any] = [v if v is None else v.detach().contiguous() for v in v_outputs]
        new_like = torch.zeros_like if ctx.kernels is _volumes else torch.empty_like  # CUDA kernels write all of it
        v_splats = [t if t is None else new_like(t) for t in ctx.splats[:-1]]
        v_means2d = new_like(ctx.splats[0][:, :2], memory_format=torch.contiguous_format)
        ctx.kernels.backward(ctx.frame, *ctx.splats, *ctx.view, *images, *v_images, *v_splats, v_means2d)
        ctx.stats.v_means2d = v_means2d
        v_background = None
        if ctx.needs_input_grad[8] and v_images[0] is not None:
            v_background = (v_images[0] * (1 - images[1])[..., None]).sum((0, 1))
        return *v_splats, v_background, None, None, None, None
