"""Rasterization of 2D surfels: colour, alpha, mean and median depth, normal and, on request, distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _surfels
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.native.cuda.surfels import SurfelKernels
from mgsr.native.structs import SurfelGradients, SurfelImageGradients, SurfelImages, SurfelSplats, SurfelView
from mgsr.ops.raster import Rasterize, SplatStats


@dataclass(frozen=True)
class SurfelOptions:
    """The options of the surfel rasterizer.

    near: camera units; nearer splat centres and nearer hits are culled.
    far: camera units; near and far normalise the distortion's depths, and far culls nothing.
    low_pass: px^2, the variance of the least footprint around the projected centre.
    distortion: whether to render the distortion.

    The low-pass of 2DGS is 0.5 px^2. It widens silhouettes, and training compensates by a smaller object. The default
    is close to a pixel's own variance of 1/12.
    """

    near: float = 0.01
    far: float = 100.0
    low_pass: float = 0.1
    distortion: bool = False


@dataclass(frozen=True)
class SurfelRaster:
    """The images of a surfel rendering.

    color [H,W,3]: over the background.
    alpha [H,W]: 1 - transmittance.
    depth [H,W]: mean camera z, 0 without splats.
    median_depth [H,W]: camera z of the splat at which transmittance falls below 1/2; 0 if it stays above.
    normal [H,W,3]: world frame, towards the camera, the sum of alpha T n, not renormalised.
    distortion [H,W]: the sum over pairs of splats (each pair once) of w_i w_j (m_i - m_j)^2, with w = alpha T and
    m = (z - near) / (far - near); None if not requested.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor
    median_depth: Tensor
    normal: Tensor
    distortion: Tensor | None
    stats: SplatStats


def rasterize_surfels(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    background: Tensor,
    options: SurfelOptions | None = None,
) -> SurfelRaster:
    """Blend surfels front to back into images; gradients flow to all splat tensors and to the background.

    means [N,3]: in the world frame.
    quats [N,4]: wxyz, any length but zero. The first two columns of their rotation are the surfel's tangents, the third
    is its normal.
    scales [N,2]: world units, linear, > 0.
    opacities [N]: in [0,1].
    colors [N,3], background [3].

    A splat with a non-finite value is left out. Splats are sorted by the camera z of their centres.

    The weight of a splat at a pixel is the larger of two. The first is exp(-(u^2 + v^2) / 2) at the point (u, v) where
    the pixel's ray meets the splat's plane beyond `near`. The second is exp(-d^2 / (2 low_pass)) at d pixels from the
    projected centre, at the centre's depth. An edge-on surfel, whose plane meets the ray at an angle with a sine below
    1e-3, has only the second. alpha = min(0.999, opacity * weight) counts from 1/255. Blending ends before the splat
    that would leave a transmittance under 1e-4. stats.v_means2d is the gradient with respect to a shift of a splat's
    weights in the image plane.

    Raises TensorError for a wrong shape or dtype, or for options without 0 < near < far and low_pass > 0.
    Source: 2DGS, Eq. 4-13; method.md "2D branch". Deviation: distortion squares differences of plain depth.
    """
    options = options or SurfelOptions()
    if not (0 < options.near < options.far and options.low_pass > 0):
        raise TensorError(f"options: expected 0 < near < far and low_pass > 0, got {options}")
    check_tensors(
        means=(means, "N 3"),
        quats=(quats, "N 4"),
        scales=(scales, "N 2"),
        opacities=(opacities, "N"),
        colors=(colors, "N 3"),
        background=(background, "3"),
    )
    splats = SurfelSplats(
        means=means, quats=quats, scales=scales, opacities=opacities, colors=colors, background=background
    )
    differentiable = torch.is_grad_enabled() and any(t.requires_grad for t in splats)
    pass_ = SurfelPass(camera, options, launcher_for(means), differentiable)
    color, alpha, depth, median_depth, normal, distortion = Rasterize.apply(pass_, *splats)
    return SurfelRaster(color, alpha, depth, median_depth, normal, distortion, pass_.stats)


class SurfelPass:
    """One rendering of surfels, forward and backward, outside the graph.

    differentiable: whether `backward` will be called; stats: of the rendering, once it is done.
    """

    Splats, Images, ImageGradients = SurfelSplats, SurfelImages, SurfelImageGradients

    def __init__(self, camera: Camera, options: SurfelOptions, launcher: Launcher | None, differentiable: bool) -> None:
        self.stats = SplatStats(torch.empty(0))
        self._kernels = _surfels if launcher is None else SurfelKernels(launcher, keep=differentiable)
        self._distortion = options.distortion
        self._view = SurfelView(camera=camera, near=options.near, far=options.far, low_pass=options.low_pass)
        self._frame: Any = None

    def forward(self, splats: SurfelSplats) -> SurfelImages:
        """Render the images, each [H,W] or [H,W,3]; splats: contiguous."""
        means = splats.means
        plane = (self._view.camera.height, self._view.camera.width)
        images = SurfelImages(
            color=means.new_empty(*plane, 3),
            alpha=means.new_empty(plane),
            depth=means.new_empty(plane),
            median_depth=means.new_empty(plane),
            normal=means.new_empty(*plane, 3),
            distortion=means.new_empty(plane) if self._distortion else None,
        )
        self.stats.radii = means.new_empty(means.shape[0])
        self._frame = self._kernels.forward(splats, self._view, images, self.stats.radii)
        return images

    def backward(self, splats: SurfelSplats, images: SurfelImages, v_images: SurfelImageGradients) -> SurfelGradients:
        """Return the splats' gradients [N,...], given those of the images, [H,W] or [H,W,3], contiguous or None."""
        # The CUDA kernels write every element.
        new_like = torch.zeros_like if self._kernels is _surfels else torch.empty_like
        v_splats = SurfelGradients(
            means=new_like(splats.means),
            quats=new_like(splats.quats),
            scales=new_like(splats.scales),
            opacities=new_like(splats.opacities),
            colors=new_like(splats.colors),
            means2d=new_like(splats.means[:, :2], memory_format=torch.contiguous_format),
        )
        self._kernels.backward(self._frame, splats, self._view, images, v_images, v_splats)
        self.stats.v_means2d = v_splats.means2d
        return v_splats
