"""The CUDA half of the image family: the same calls as `mgsr.native._image`, but sums stay on the GPU."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, addresses, pointer, pointers
from mgsr.native.cuda.terms import Sums
from mgsr.native.cuda.view import intrinsics
from mgsr.native.structs import DepthSurface, ImagePair

PIXEL_THREADS = 256
LOSS_WIDTH, LOSS_HEIGHT, LOSS_THREADS = 32, 16, 512


class LossParams(ctypes.Structure):
    _fields_ = (
        ("height", Int),
        ("width", Int),
        *pointers("image", "target", "mask"),
        ("l1_weight", Float),
        ("clip", Int),
        *pointers("derivatives"),
        ("derivative_count", Int),
        *pointers("sums", "v_image", "v_target"),
    )


class TvParams(ctypes.Structure):
    _fields_ = (
        *((name, Int) for name in ("height", "width", "channels")),
        *pointers("values", "guide", "mask", "v_values", "sums"),
    )


class NormalsParams(ctypes.Structure):
    _fields_ = (
        ("height", Int),
        ("width", Int),
        *pointers("depth", "alpha", "covered"),
        *((name, Float) for name in ("fx", "fy", "cx", "cy")),
        ("world_from_cam", Float * 9),
        *pointers("normals", "v_normals", "v_depth"),
    )


class AgreementParams(ctypes.Structure):
    _fields_ = (("of_depth", NormalsParams), *pointers("normal", "sums"))


class ImageKernels:
    """The kernels of losses and normals of images on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def image_loss(
        self, pair: ImagePair, v_image: Tensor | None, v_target: Tensor | None, mask_sum: float | None
    ) -> Sums:
        """Return the mean loss of two images [H,W,3].

        Writes the gradients v_image and v_target [H,W,3] of the loss's sum; None if not needed.
        """
        image, target, mask, l1_weight, clip = pair
        height, width = image.shape[:2]
        count = 0 if v_image is None else 3 if v_target is None else 4
        derivatives = image.new_empty(count, 3, height, width) if count else None
        blocks = -(-height // LOSS_HEIGHT) * -(-width // LOSS_WIDTH)
        sums = image.new_empty(blocks, 2, dtype=torch.float64)
        params = LossParams(
            *(height, width, pointer(image), pointer(target), pointer(mask), l1_weight, clip),
            *(pointer(derivatives), count, pointer(sums), pointer(v_image), pointer(v_target)),
        )
        self._launcher.launch("image", "image_loss", blocks, LOSS_THREADS, params)
        if v_image is not None:
            self._launcher.launch("image", "image_loss_gradient", blocks, LOSS_THREADS, params)
        if mask is None:
            return Sums(sums, 3.0 * height * width)
        if mask_sum is not None:
            return Sums(sums, 3.0 * mask_sum)
        return Sums(sums, 3.0, divisor=mask.sum())

    def tv(self, values: Tensor, guide: Tensor, mask: Tensor | None, v_values: Tensor | None) -> Sums:
        """Return the mean variation of values [H,W,C] over pairs and channels.

        guide [H,W,3], mask [H,W]: as in `edge_aware_tv_term`. Writes the gradient v_values [H,W,C] of the sum; None:
        not needed.
        """
        height, width, channels = values.shape
        blocks = -(-height * width // PIXEL_THREADS)
        sums = values.new_empty(blocks, 2, dtype=torch.float64)
        arrays = addresses(values, guide, mask, v_values, sums)
        params = TvParams(height, width, channels, *arrays)
        self._launcher.launch("image", "image_tv", blocks, PIXEL_THREADS, params)
        return Sums(sums, float(channels), counted=True)

    def normal_agreement(
        self, surface: DepthSurface, covered: Tensor, normals: Tensor, from_depth: Tensor, v_depth: Tensor | None
    ) -> Sums:
        """Return the mean of 1 - n . n_depth over the covered pixels.

        normals [H,W,3]: n; covered [H,W]: 0 or 1. Writes from_depth [H,W,3] and v_depth [H,W]: the gradients of the sum
        with respect to n and to the depth, each times -1.
        """
        depth = surface.depth
        blocks = -(-depth.numel() // PIXEL_THREADS)
        sums = depth.new_empty(blocks, 2, dtype=torch.float64)
        of_depth = _normals_params(surface, covered, (from_depth, normals, v_depth))
        params = AgreementParams(of_depth, pointer(normals), pointer(sums))
        self._launcher.launch("image", "image_normal_agreement", blocks, PIXEL_THREADS, params)
        return Sums(sums, 1.0, counted=True)

    def depth_normals(self, surface: DepthSurface, normals: Tensor) -> None:
        """Write the normals [H,W,3]."""
        self._normals("image_depth_normals", surface, (normals, None, None))

    def depth_normals_vjp(self, surface: DepthSurface, v_normals: Tensor, v_depth: Tensor) -> None:
        """Write the depth's gradient v_depth [H,W], given v_normals [H,W,3]."""
        self._normals("image_depth_normals_vjp", surface, (None, v_normals, v_depth))

    def _normals(self, kernel: str, surface: DepthSurface, arrays: tuple[Tensor | None, ...]) -> None:
        params = _normals_params(surface, None, arrays)
        self._launcher.launch("image", kernel, -(-surface.depth.numel() // PIXEL_THREADS), PIXEL_THREADS, params)


def _normals_params(surface: DepthSurface, covered: Tensor | None, arrays: tuple[Tensor | None, ...]) -> NormalsParams:
    depth, alpha, camera = surface
    world_from_cam = (Float * 9)(*camera.cam_from_world[:3, :3].T.ravel().tolist())
    inputs = (*depth.shape, *addresses(depth, alpha, covered), *intrinsics(camera), world_from_cam)
    return NormalsParams(*inputs, *addresses(*arrays))
