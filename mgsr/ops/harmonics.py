"""Colours of splats from spherical harmonics, as the camera sees them."""

from __future__ import annotations

from typing import Any

import torch

from mgsr.checks import check_tensors
from mgsr.errors import TensorError
from mgsr.native import _harmonics
from mgsr.native.cuda.harmonics import HarmonicsKernels
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.native.structs import Harmonics
from mgsr.ops.arrays import once_differentiable, plain


def harmonics_to_rgb(
    coeffs: torch.Tensor, means: torch.Tensor, camera_center: torch.Tensor, degree: int
) -> torch.Tensor:
    """Return the colours [N, 3] = max(0, SH(direction) + 0.5), direction = from the camera to the splat, unit.

    coeffs: [N, K, 3], K = 1, 4, 9 or 16; gradients flow (zero for bands above ``degree``).
    means: [N, 3], world; gradients flow. camera_center: [3], world, preferably on the CPU; no gradient.
    degree: highest band used, 0..3, at most sqrt(K) - 1.

    A channel that is clipped at 0 passes no gradient. A splat at the camera's centre has a zero direction. A NaN in a
    splat's numbers makes only its own colour NaN.

    Raises TensorError for wrong shapes, dtypes or a degree that K does not hold.
    Source: the basis of 3DGS files (real harmonics with the Condon-Shortley phase, in the order y, z, x).
    """
    check_tensors(coeffs=(coeffs, "N K 3"), means=(means, "N 3"))
    check_tensors(camera_center=(camera_center, "3"))
    check_degree(coeffs, degree)
    colors: torch.Tensor = _Harmonics.apply(coeffs, means, camera_center, degree)
    return colors


def check_degree(coeffs: torch.Tensor, degree: int) -> None:
    """Check that coefficients [N,K,3] are of whole bands, up to `degree` at least; raise TensorError otherwise."""
    stored = coeffs.shape[1]
    if stored not in (1, 4, 9, 16):
        raise TensorError(f"coeffs: expected [N, K, 3] with K = 1, 4, 9 or 16, got K = {stored}")
    if not 0 <= degree <= 3 or (degree + 1) ** 2 > stored:
        raise TensorError(f"degree: expected 0..{round(stored**0.5) - 1} for K = {stored}, got {degree}")


class _Harmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, coeffs: torch.Tensor, means: torch.Tensor, center: torch.Tensor, degree: int) -> torch.Tensor:
        """Return the colours [N,3] of coeffs [N,K,3] and means [N,3], seen from a center [3]."""
        coeffs, means, center = plain(coeffs), plain(means), plain(center)
        ctx.launcher, ctx.degree = launcher_for(means), degree
        rgb = harmonics(ctx.launcher, Harmonics(coeffs=coeffs, means=means, center=center, degree=degree))
        ctx.save_for_backward(coeffs, means, center, rgb)
        return rgb

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_rgb: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None, None, None]:
        """Return the gradients of coefficients [N,K,3] and means [N,3], given that of the colours [N,3]."""
        coeffs, means, center, rgb = ctx.saved_tensors
        v_means = torch.zeros_like(means) if ctx.needs_input_grad[1] else None
        splats = Harmonics(coeffs=coeffs, means=means, center=center, degree=ctx.degree)
        return harmonics_vjp(ctx.launcher, splats, plain(rgb), plain(v_rgb), v_means), v_means, None, None


def harmonics(launcher: Launcher | None, splats: Harmonics) -> torch.Tensor:
    """Return the colours [N,3] of contiguous tensors, outside the graph.

    launcher: of the GPU's kernels; None on the CPU.
    """
    rgb = torch.empty_like(splats.means)
    kernels = _harmonics if launcher is None else HarmonicsKernels(launcher)
    kernels.forward(splats, rgb)
    return rgb


def harmonics_vjp(
    launcher: Launcher | None,
    splats: Harmonics,
    rgb: torch.Tensor,
    v_rgb: torch.Tensor,
    v_means: torch.Tensor | None,
) -> torch.Tensor:
    """Return the gradient of the coefficients [N,K,3], and add that of the means to v_means [N,3], if given.

    rgb, v_rgb [N,3]: the colours and their gradient.
    """
    v_coeffs = torch.empty_like(splats.coeffs)
    kernels = _harmonics if launcher is None else HarmonicsKernels(launcher)
    kernels.backward(splats, rgb, v_rgb, v_coeffs, v_means)
    return v_coeffs
