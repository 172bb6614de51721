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
    _check(sizes["S"], normals, pixels)
    light: torch.Tensor = _EnvironmentMapLookup.apply(maps, normals, None, camera, pixels)
    return light


def look_up_samples(maps: torch.Tensor, samples: torch.Tensor, camera: Camera, pixels: torch.Tensor) -> torch.Tensor:
    """Return the light [H, W, 3] that pixels with several normals each reflect towards the camera.

    The light of a pixel is the sum of what its samples reflect, each times its weight.

    maps: [2, S, S, 3], as for `look_up_environment_map`; gradients flow.
    samples: [P, N, N, 3], normals in the world frame, each as long as its weight. Those of a pixel lie in the middles
    of N x N equal parts, row by row.
    pixels: [P] int64, unique flat indices (row x W + column) of the pixels; the light of others is 0.

    The result has the same bytes for any number of threads.

    Raises TensorError for wrong shapes or dtypes.
    """
    sizes = check_tensors(maps=(maps, "2 S S 3"), samples=(samples, "P N N 3"))
    _check(sizes["S"], samples, pixels)
    if len(pixels) != sizes["P"]:
        raise TensorError(f"pixels: expected one for each of the {sizes['P']} samples' pixels, got {len(pixels)}")
    if not sizes["N"]:
        raise TensorError(f"samples: expected at least one for each pixel, got {list(samples.shape)}")
    light: torch.Tensor = _EnvironmentMapLookup.apply(maps, None, samples, camera, pixels)
    return light


def _check(side: int, normals: torch.Tensor, pixels: torch.Tensor | None) -> None:
    """Check a map's side, and that pixels [P] are int64 on the device of the normals [...,3]."""
    if not side:
        raise TensorError("maps: expected at least one texel, got [2, 0, 0, 3]")
    if pixels is not None and (pixels.ndim != 1 or pixels.dtype != torch.int64 or pixels.device != normals.device):
        came = f"{pixels.dtype} {list(pixels.shape)} on {pixels.device}"
        raise TensorError(f"pixels: expected int64 [P] on {normals.device}, got {came}")


class _EnvironmentMapLookup(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        maps: torch.Tensor,
        normals: torch.Tensor | None,
        samples: torch.Tensor | None,
        camera: Camera,
        pixels: torch.Tensor | None,
    ) -> torch.Tensor:
        """Return the light [H,W,3] that maps [2,S,S,3] send to normals [H,W,3] or samples [P,N,N,3].

        It is computed at pixels [P]; None for all.
        """
        maps = plain(maps)
        normals, samples, pixels = (None if each is None else plain(each) for each in (normals, samples, pixels))
        launcher = launcher_for(maps)
        ctx.kernels = _environment_map if launcher is None else EnvironmentMapKernels(launcher)
        light = _image(maps, camera, pixels)
        lookup = EnvironmentMapLookup(maps=maps, normals=normals, samples=samples, pixels=pixels, camera=camera)
        ctx.kernels.forward(lookup, light)
        ctx.save_for_backward(maps, normals, samples, pixels)
        ctx.camera = camera
        return light

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_light: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """Return the gradients of maps [2,S,S,3] and normals [H,W,3], given that of the light [H,W,3]."""
        maps, normals, samples, pixels = ctx.saved_tensors
        v_maps = torch.empty_like(maps) if ctx.needs_input_grad[0] else None
        v_normals = _image(maps, ctx.camera, pixels) if ctx.needs_input_grad[1] else None
        lookup = EnvironmentMapLookup(maps=maps, normals=normals, samples=samples, pixels=pixels, camera=ctx.camera)
        ctx.kernels.backward(lookup, plain(v_light), v_maps, v_normals)
        return v_maps, v_normals, None, None, None


def _image(like: torch.Tensor, camera: Camera, pixels: torch.Tensor | None) -> torch.Tensor:
    """Allocate the kernels' result [H,W,3], with zeros if they write only chosen pixels."""
    shape = camera.height, camera.width, 3
    return like.new_empty(shape) if pixels is None else like.new_zeros(shape)
