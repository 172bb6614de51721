"""The CUDA half of the image family: as `mgsr.native._image`, but means stay on the card."""

from __future__ import annotations

import ctypes
from enum import IntEnum

import torch
from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Double, Float, Int, Pointer, pointer, pointers

PIXEL_THREADS, MEAN_THREADS = 256, 256
LOSS_WIDTH, LOSS_HEIGHT, LOSS_THREADS = 32, 16, 512
SSIM_RADIUS = 5

RegionTuple = tuple[int, int, int, int]


class WeightFrom(IntEnum):
    """Of kernels/image/image.cu: by what, times a factor, a total is divided."""

    FACTOR_ALONE = 0
    SUMS = 1
    POINTER = 2


class Region(ctypes.Structure):
    """Region of kernels/image/loss_cuda.h."""

    _fields_ = tuple((name, Int) for name in ("y0", "y1", "x0", "x1"))


class LossParams(ctypes.Structure):
    _fields_ = (
        ("height", Int),
        ("width", Int),
        *pointers("image", "target", "mask"),
        ("l1_weight", Float),
        ("region", Region),
        ("maps", Region),
        *pointers("derivatives"),
        ("derivative_count", Int),
        *pointers("sums", "v_image", "v_target"),
    )


class TvParams(ctypes.Structure):
    _fields_ = (
        *((name, Int) for name in ("height", "width", "channels")),
        *pointers("values", "guide", "mask", "v_values", "sums"),
    )


class MeanParams(ctypes.Structure):
    _fields_ = (
        ("sums", Pointer),
        ("blocks", Int),
        ("weight_from", Int),
        ("factor", Double),
        *pointers("weight", "mean"),
    )


class NormalsParams(ctypes.Structure):
    _fields_ = (
        ("height", Int),
        ("width", Int),
        *pointers("depth", "alpha"),
        *((name, Float) for name in ("fx", "fy", "cx", "cy")),
        ("world_from_cam", Float * 9),
        *pointers("normals", "v_normals", "v_depth"),
    )


class ImageKernels:
    """Losses and normals of images on one launcher."""

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher

    def image_loss(
        self,
        image: Tensor,
        target: Tensor,
        l1_weight: float,
        mask: Tensor | None,
        region: RegionTuple,
        v_image: Tensor | None,
        v_target: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """The mean loss and what the gradients written must be multiplied by, both scalars on the tensors' device."""
        height, width = image.shape[:2]
        maps = _grown(region, height, width)
        count = 0 if v_image is None else 3 if v_target is None else 4
        derivatives = image.new_empty(count, 3, maps[1] - maps[0], maps[3] - maps[2]) if count else None
        blocks = _loss_blocks(maps)
        sums = image.new_empty(blocks, 2, dtype=torch.float64)
        params = LossParams(
            *(height, width, pointer(image), pointer(target), pointer(mask), l1_weight, Region(*region), Region(*maps)),
            *(pointer(derivatives), count, pointer(sums), pointer(v_image), pointer(v_target)),
        )
        self._launcher.launch("image", "image_loss", blocks, LOSS_THREADS, params)
        if v_image is not None:
            self._launcher.launch("image", "image_loss_gradient", _loss_blocks(region), LOSS_THREADS, params)
        if mask is None:
            return self._mean(sums, WeightFrom.FACTOR_ALONE, 3.0 * height * width)
        return self._mean(sums, WeightFrom.POINTER, 3.0, mask.sum(dtype=torch.float64))

    def tv(self, values: Tensor, guide: Tensor, mask: Tensor | None, v_values: Tensor | None) -> tuple[Tensor, Tensor]:
        """As `image_loss`, for the mean over pairs and channels."""
        height, width, channels = values.shape
        blocks = -(-height * width // PIXEL_THREADS)
        sums = values.new_empty(blocks, 2, dtype=torch.float64)
        arrays = (pointer(t) for t in (values, guide, mask, v_values, sums))
        params = TvParams(height, width, channels, *arrays)
        self._launcher.launch("image", "image_tv", blocks, PIXEL_THREADS, params)
        return self._mean(sums, WeightFrom.SUMS, float(channels))

    def depth_normals(
        self,
        depth: Tensor,
        alpha: Tensor | None,
        intrinsics: tuple[float, float, float, float],
        world_from_cam: list[float],
        normals: Tensor,
    ) -> None:
        """Write the normals [H,W,3]."""
        self._normals("image_depth_normals", depth, alpha, intrinsics, world_from_cam, (normals, None, None))

    def depth_normals_vjp(
        self,
        depth: Tensor,
        alpha: Tensor | None,
        intrinsics: tuple[float, float, float, float],
        world_from_cam: list[float],
        v_normals: Tensor,
        v_depth: Tensor,
    ) -> None:
        """Write the depth's gradient [H,W]."""
        arrays = (None, v_normals, v_depth)
        self._normals("image_depth_normals_vjp", depth, alpha, intrinsics, world_from_cam, arrays)

    def _normals(
        self,
        kernel: str,
        depth: Tensor,
        alpha: Tensor | None,
        intrinsics: tuple[float, float, float, float],
        world_from_cam: list[float],
        arrays: tuple[Tensor | None, ...],
    ) -> None:
        inputs = (*depth.shape, pointer(depth), pointer(alpha), *intrinsics, (Float * 9)(*world_from_cam))
        params = NormalsParams(*inputs, *(pointer(t) for t in arrays))
        self._launcher.launch("image", kernel, -(-depth.numel() // PIXEL_THREADS), PIXEL_THREADS, params)

    def _mean(
        self, sums: Tensor, weight_from: WeightFrom, factor: float, weight: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        mean = sums.new_empty(2, dtype=torch.float32)
        params = MeanParams(pointer(sums), len(sums), weight_from, factor, pointer(weight), pointer(mean))
        self._launcher.launch("image", "image_mean", 1, MEAN_THREADS, params)
        return mean[0], mean[1]


def _grown(region: RegionTuple, height: int, width: int) -> RegionTuple:
    """Where windows reach into the region; empty where it is."""
    y0, y1, x0, x1 = region
    if y0 >= y1 or x0 >= x1:
        return (0, 0, 0, 0)
    rows = (max(y0 - SSIM_RADIUS, 0), min(y1 + SSIM_RADIUS, height))
    return (*rows, max(x0 - SSIM_RADIUS, 0), min(x1 + SSIM_RADIUS, width))


def _loss_blocks(region: RegionTuple) -> int:
    y0, y1, x0, x1 = region
    return -(-(y1 - y0) // LOSS_HEIGHT) * -(-(x1 - x0) // LOSS_WIDTH)
