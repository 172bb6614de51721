"""Rasterization of 3D Gaussians, with one opacity, or a transmitted and a reflected one over the same footprint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.data.camera import Camera
from mgsr.native import _gaussians
from mgsr.native.cuda.gaussians import GaussianKernels
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.native.structs import (
    GaussianGradients,
    GaussianImageGradients,
    GaussianImages,
    GaussianSplats,
    GaussianView,
)
from mgsr.ops.raster import Rasterize, SplatStats


class Reflected(NamedTuple):
    """The reflected part of each Gaussian: opacities [N] in [0,1], colors [N,3], weights [N] (beta)."""

    opacities: Tensor
    colors: Tensor
    weights: Tensor


@dataclass(frozen=True)
class GaussianOptions:
    """The options of the rasterizer of 3D Gaussians.

    near: camera units; nearer splats are left out.
    low_pass: px^2, added to each projected covariance.
    compensate: whether to lower the opacity to compensate for the low-pass, so that zooming out preserves energy.
    depth: whether to render depth.
    """

    near: float = 0.01
    low_pass: float = 0.3
    compensate: bool = False
    depth: bool = True


@dataclass(frozen=True)
class GaussianRaster:
    """The images of a rendering of 3D Gaussians.

    color [H,W,3]: transmitted light over the background.
    alpha [H,W]: 1 - transmittance.
    depth [H,W]: mean camera z, 0 without splats; None if not requested.
    reflected [H,W,3], weight [H,W]: None for a single opacity.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor | None
    reflected: Tensor | None
    weight: Tensor | None
    stats: SplatStats


def rasterize_gaussians(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    background: Tensor,
    reflected: Reflected | None = None,
    options: GaussianOptions | None = None,
) -> GaussianRaster:
    """Blend Gaussians front to back into images; gradients flow to all splat tensors.

    means [N,3]: in the world frame.
    quats [N,4]: wxyz, any length but zero.
    scales [N,3]: world units, linear.
    opacities [N]: in [0,1].
    colors [N,3], background [3].

    A splat with a non-finite value is left out. alpha = min(0.999, opacity * G) counts from 1/255. Blending ends before
    the splat that would leave a transmittance under 1e-4, separately for each of the two opacities.

    Raises TensorError for a wrong shape or dtype. Source: supplement, Eq. 16-19; method.md "3D branch".
    """
    options = options or GaussianOptions()
    refl_opacities, refl_colors, weights = reflected or (None, None, None)
    check_tensors(
        means=(means, "N 3"),
        quats=(quats, "N 4"),
        scales=(scales, "N 3"),
        opacities=(opacities, "N"),
        colors=(colors, "N 3"),
        background=(background, "3"),
        refl_opacities=(refl_opacities, "? N"),
        refl_colors=(refl_colors, "? N 3"),
        weights=(weights, "? N"),
    )
    splats = GaussianSplats(
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        colors=colors,
        refl_opacities=refl_opacities,
        refl_colors=refl_colors,
        weights=weights,
        background=background,
    )
    differentiable = torch.is_grad_enabled() and any(t is not None and t.requires_grad for t in splats)
    pass_ = GaussianPass(camera, options, launcher_for(means), differentiable)
    color, alpha, depth, refl, weight = Rasterize.apply(pass_, *splats)
    return GaussianRaster(color, alpha, depth, refl, weight, pass_.stats)


class GaussianPass:
    """One rendering of Gaussians, forward and backward, outside the graph.

    differentiable: whether `backward` will be called; stats: of the rendering, once it is done.
    """

    Splats, Images, ImageGradients = GaussianSplats, GaussianImages, GaussianImageGradients

    def __init__(
        self, camera: Camera, options: GaussianOptions, launcher: Launcher | None, differentiable: bool
    ) -> None:
        self.stats = SplatStats(torch.empty(0))
        self._kernels = _gaussians if launcher is None else GaussianKernels(launcher, keep=differentiable)
        self._depth = options.depth
        self._view = GaussianView(
            camera=camera, near=options.near, low_pass=options.low_pass, compensate=options.compensate
        )
        self._frame: Any = None

    def forward(self, splats: GaussianSplats) -> GaussianImages:
        """Render the images, each [H,W] or [H,W,3]; splats: contiguous."""
        means, dual = splats.means, splats.refl_opacities is not None
        plane = (self._view.camera.height, self._view.camera.width)
        images = GaussianImages(
            color=means.new_empty(*plane, 3),
            alpha=means.new_empty(plane),
            depth=means.new_empty(plane) if self._depth else None,
            reflected=means.new_empty(*plane, 3) if dual else None,
            weight=means.new_empty(plane) if dual else None,
        )
        self.stats.radii = means.new_empty(means.shape[0])
        self._frame = self._kernels.forward(splats, self._view, images, self.stats.radii)
        return images

    def backward(
        self, splats: GaussianSplats, images: GaussianImages, v_images: GaussianImageGradients
    ) -> GaussianGradients:
        """Return the splats' gradients [N,...], given those of the images, [H,W] or [H,W,3], contiguous or None."""
        # The CUDA kernels write every element.
        new_like = torch.zeros_like if self._kernels is _gaussians else torch.empty_like
        v_splats = GaussianGradients(
            means=new_like(splats.means),
            quats=new_like(splats.quats),
            scales=new_like(splats.scales),
            opacities=new_like(splats.opacities),
            colors=new_like(splats.colors),
            refl_opacities=None if splats.refl_opacities is None else new_like(splats.refl_opacities),
            refl_colors=None if splats.refl_colors is None else new_like(splats.refl_colors),
            weights=None if splats.weights is None else new_like(splats.weights),
            means2d=new_like(splats.means[:, :2], memory_format=torch.contiguous_format),
        )
        self._kernels.backward(self._frame, splats, self._view, images, v_images, v_splats)
        self.stats.v_means2d = v_splats.means2d
        return v_splats
