"""Normals of the surface that a depth map describes."""

from __future__ import annotations

from typing import Any

import torch

from mgsr.checks import check_tensors
from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _image
from mgsr.native.cuda.image import ImageKernels
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.terms import Sums
from mgsr.native.structs import DepthSurface
from mgsr.ops.arrays import once_differentiable, plain
from mgsr.ops.terms import Slope, Term, Total, needs_gradient


def depth_to_normals(depth: torch.Tensor, camera: Camera, alpha: torch.Tensor | None = None) -> torch.Tensor:
    """Return the normals [H, W, 3] of a depth map: world frame, facing the camera, of length ``alpha`` or 1.

    A normal is the cross product of the central differences of the back-projected points. It is zero and passes no
    gradient at the image's border, and where the pixel or one of its four neighbours has no depth (<= 0 or NaN).

    depth: [H, W], camera z, scene units; gradients flow (to the four neighbours of each normal).
    alpha: [H, W], or None for 1; no gradient.

    Raises TensorError for wrong shapes or dtypes, or a camera of another size.
    Source: method, "Surface normal"; 2DGS, Eq. 16.
    """
    sizes = check_tensors(depth=(depth, "H W"), alpha=(alpha, "? H W"))
    if (sizes["H"], sizes["W"]) != (camera.height, camera.width):
        expected, came = f"[{camera.height}, {camera.width}]", f"[{sizes['H']}, {sizes['W']}]"
        raise TensorError(f"depth: expected the camera's {expected}, got {came}; use camera.resized(width, height)")
    normals: torch.Tensor = _DepthNormals.apply(depth, camera, alpha)
    return normals


def normal_agreement_term(
    normals: torch.Tensor, depth: torch.Tensor, camera: Camera, alpha: torch.Tensor, covered: torch.Tensor
) -> Term:
    """Return the mean over the covered pixels of 1 - n . n_depth, 0 where nothing is covered.

    normals: [H, W, 3], world frame, as long as alpha; gradients flow. depth: [H, W], camera z; gradients flow. alpha:
    [H, W], the length of the depth's normals (2DGS, Eq. 13); no gradient. covered: [H, W], 0 or 1.

    Raises TensorError for wrong shapes or dtypes. Source: method, "Surface normal".
    """
    check_tensors(normals=(normals, "H W 3"), depth=(depth, "H W"), alpha=(alpha, "H W"), covered=(covered, "H W"))
    of_normals, of_depth = needs_gradient(normals, depth)
    along, lengths, counted = plain(normals), plain(alpha), plain(covered)
    surface = DepthSurface(depth=plain(depth), alpha=lengths, camera=camera)
    from_depth = torch.empty_like(along)
    v_depth = torch.empty_like(depth) if of_depth else None
    launcher = launcher_for(depth)
    sums: Total | Sums
    if launcher is None:
        surface, count = surface._replace(alpha=lengths * counted), float(counted.sum())
        _image.depth_normals(surface, from_depth)
        sums = Total(count - float(along.reshape(-1) @ from_depth.reshape(-1)), count)
        if v_depth is not None:
            _image.depth_normals_vjp(surface, along, v_depth)
    else:
        sums = ImageKernels(launcher).normal_agreement(surface, counted, along, from_depth, v_depth)
    slopes = [(normals, from_depth)] * of_normals + [(depth, v_depth)] * of_depth
    return Term(sums, tuple(Slope(each, v, factor=-1.0) for each, v in slopes if v is not None))


class _DepthNormals(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, depth: torch.Tensor, camera: Camera, alpha: torch.Tensor | None) -> torch.Tensor:
        """Return the normals [H,W,3] of a depth [H,W], of length alpha [H,W]."""
        depth, alpha = plain(depth), None if alpha is None else plain(alpha)
        launcher = launcher_for(depth)
        ctx.kernels = _image if launcher is None else ImageKernels(launcher)
        normals = depth.new_empty(*depth.shape, 3)
        ctx.kernels.depth_normals(DepthSurface(depth=depth, alpha=alpha, camera=camera), normals)
        ctx.save_for_backward(depth, alpha)
        ctx.camera = camera
        return normals

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_normals: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        """Return the gradient [H,W] of the depth, given that of the normals [H,W,3]."""
        depth, alpha = ctx.saved_tensors
        v_depth = torch.empty_like(depth)
        surface = DepthSurface(depth=depth, alpha=alpha, camera=ctx.camera)
        ctx.kernels.depth_normals_vjp(surface, plain(v_normals), v_depth)
        return v_depth, None, None
