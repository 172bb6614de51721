"""Rasterization of 3D Gaussians, with one opacity, or a transmitted and a reflected one over the same footprint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.data.camera import Camera
from mgsr.native import _gaussians
from mgsr.native.cuda.gaussians import GaussianKernels
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.ops.raster import Rasterize, SplatStats


class Reflected(NamedTuple):
    """The reflected part of each Gaussian: opacities [N] in [0,1], colors [N,3], weights [N] (beta)."""

    opacities: Tensor
    colors: Tensor
    weights: Tensor


@dataclass(frozen=True)
class GaussianOptions:
    """The options of the rasterizer of 3D Gaussians.

    near: camera units, splats nearer are left out; low_pass: px^2 added to each projected covariance; compensate: lower
    the opacity to compensate for the low-pass, so that zooming out preserves energy; depth: whether to render depth.
    """

    near: float = 0.01
    low_pass: float = 0.3
    compensate: bool = False
    depth: bool = True


@dataclass(frozen=True)
class GaussianRaster:
    """The images of a rendering of 3D Gaussians.

    color [H,W,3]: transmitted light over the background; alpha [H,W]: 1 - transmittance; depth [H,W]: mean camera z, 0
    where nothing is, or None; reflected [H,W,3] and weight [H,W]: None for single opacity.
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

    means [N,3] world; quats [N,4] wxyz, any length but zero; scales [N,3] world units, linear; opacities [N] in
    [0,1]; colors [N,3]; background [3]. A splat with a non-finite value is left out. alpha =
    min(0.999, opacity * G) counts from 1/255; a pixel stops before the splat that would leave a transmittance under
    1e-4 (for each of the two opacities on its own).

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
    tensors = (means, quats, scales, opacities, colors, refl_opacities, refl_colors, weights, background)
    differentiable = torch.is_grad_enabled() and any(t is not None and t.requires_grad for t in tensors)
    pass_ = GaussianPass(camera, options, launcher_for(means), differentiable)
    color, alpha, depth, refl, weight = Rasterize.apply(pass_, *tensors)
    return GaussianRaster(color, alpha, depth, refl, weight, pass_.stats)


class GaussianPass:
    """One rendering of Gaussians, forward and back, outside the graph.

    differentiable: whether `backward` will be called; stats: of the rendering, once it is done.
    """

    def __init__(
        self, camera: Camera, options: GaussianOptions, launcher: Launcher | None, differentiable: bool
    ) -> None:
        self.stats = SplatStats(torch.empty(0))
        self._kernels = _gaussians if launcher is None else GaussianKernels(launcher, keep=differentiable)
        self._depth = options.depth
        self._view = (
            np.ascontiguousarray(camera.K, dtype=np.float64),
            np.ascontiguousarray(camera.cam_from_world, dtype=np.float64),
            camera.width,
            camera.height,
            options.near,
            options.low_pass,
            options.compensate,
        )
        self._frame: Any = None

    def forward(self, splats: Sequence[Tensor | None]) -> tuple[Tensor | None, ...]:
        """Render color, alpha, depth, reflected and weight, each [H,W] or [H,W,3].

        splats: contiguous, the tensors of `rasterize_gaussians` in its order, with the reflected three, or None for
        each of them, before the background.
        """
        means, dual = splats[0], splats[5] is not None
        assert means is not None
        plane, triple = self._view[3:1:-1], (*self._view[3:1:-1], 3)
        color, alpha = means.new_empty(triple), means.new_empty(plane)
        depth = means.new_empty(plane) if self._depth else None
        refl, weight = (means.new_empty(triple), means.new_empty(plane)) if dual else (None, None)
        self.stats.radii = means.new_empty(means.shape[0])
        self._frame = self._kernels.forward(*splats, *self._view, color, alpha, depth, refl, weight, self.stats.radii)
        return color, alpha, depth, refl, weight

    def backward(
        self, splats: Sequence[Tensor | None], images: Sequence[Tensor | None], v_images: Sequence[Tensor | None]
    ) -> list[Tensor | None]:
        """Return the splat tensors' gradients [N,...], except the background's, given those of the images.

        Each image's gradient, [H,W] or [H,W,3], is contiguous or None.
        """
        # The CUDA kernels write every element.
        new_like = torch.zeros_like if self._kernels is _gaussians else torch.empty_like
        v_splats = [t if t is None else new_like(t) for t in splats[:-1]]
        assert splats[0] is not None
        v_means2d = new_like(splats[0][:, :2], memory_format=torch.contiguous_format)
        self._kernels.backward(self._frame, *splats, *self._view, *images, *v_images, *v_splats, v_means2d)
        self.stats.v_means2d = v_means2d
        return v_splats
