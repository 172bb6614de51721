"""Environment map look-up: the light that a surface reflects."""

from __future__ import annotations

from typing import Any

import torch

from mgsr.checks import check_tensors
from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _environment_map
from mgsr.native.cuda.environment_map import EnvironmentMapKernels
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.structs import EnvironmentMapLookup
from mgsr.ops.arrays import once_differentiable, plain


def look_up_environment_map(
    maps: torch.Tensor, normals: torch.Tensor, camera: Camera, pixels: torch.Tensor | None = None
) -> torch.Tensor:
    """Return the light [H, W, 3] that each pixel's surface reflects towards the camera: the sum of both maps.

    maps: [2, S, S, 3], light by direction, row by row; gradients flow. Each is octahedral: the octahedron |x| + |y| +
    |z| = 1 seen from +z, with its far half unfolded over the corners. The first is in the world's axes. The second is
    in the camera's axes, and its centre points back to the camera. Lookups are bilinear between texel centres and
    clamped outside them.
    normals: [H, W, 3], world frame, of any length; gradients flow. A zero normal gives undefined light and no gradient.
    pixels: [P] int64, unique flat indices (row x W + column) of the pixels to compute; elsewhere light and gradients
    are 0. By default all.

    The result has the same bytes for any number of threads.

    Raises TensorError for wrong shapes or dtypes, or a camera of another size.
    """
    sizes = check_tensors(maps=(maps, "2 S S 3"), normals=(normals, "H W 3"))
    if (sizes["H"], sizes["W"]) != (camera.height, camera.width):
        expected, came = f"[{camera.height}, {camera.width}, 3]", f"[{sizes['H']}, {sizes['W']}, 3]"
        raise TensorError(f"normals: expected the camera's {expected}, got {came}; use camera.resized(width, height)")
    if not sizes["S"]:
        raise TensorError("maps: expected at least one texel, got [2, 0, 0, 3]")
    if pixels is not None and (pixels.ndim != 1 or pixels.dtype != torch.int64 or pixels.device != normals.device):
        came = f"{pixels.dtype} {list(pixels.shape)} on {pixels.device}"
        raise TensorError(f"pixels: expected int64 [P] on {normals.device}, got {came}")
    light: torch.Tensor = _EnvironmentMapLookup.apply(maps, normals, camera, pixels)
    return light


class _EnvironmentMapLookup(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, maps: torch.Tensor, normals: torch.Tensor, camera: Camera, pixels: torch.Tensor | None
    ) -> torch.Tensor:
        """Return the light [H,W,3] that maps [2,S,S,3] send to normals [H,W,3], at pixels [P] or everywhere."""
        maps, normals, pixels = plain(maps), plain(normals), None if pixels is None else plain(pixels)
        launcher = launcher_for(normals)
        ctx.kernels = _environment_map if launcher is None else EnvironmentMapKernels(launcher)
        light = _like(normals, pixels)
        lookup = EnvironmentMapLookup(maps=maps, normals=normals, pixels=pixels, camera=camera)
        ctx.kernels.forward(lookup, light)
        ctx.save_for_backward(maps, normals, pixels)
        ctx.camera = camera
        return light

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_light: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor | None, None, None]:
        """Return the gradients of maps [2,S,S,3] and normals [H,W,3], given that of the light [H,W,3]."""
        maps, normals, pixels = ctx.saved_tensors
        v_maps = torch.empty_like(maps) if ctx.needs_input_grad[0] else None
        v_normals = _like(normals, pixels) if ctx.needs_input_grad[1] else None
        lookup = EnvironmentMapLookup(maps=maps, normals=normals, pixels=pixels, camera=ctx.camera)
        ctx.kernels.backward(lookup, plain(v_light), v_maps, v_normals)
        return v_maps, v_normals, None, None


def _like(normals: torch.Tensor, pixels: torch.Tensor | None) -> torch.Tensor:
    """Allocate the kernels' result [H,W,3], with zeros if they write only chosen pixels."""
    return torch.empty_like(normals) if pixels is None else torch.zeros_like(normals)
