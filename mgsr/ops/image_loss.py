"""The render loss: L1 and structural similarity in one pass, with the gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch.autograd.function import once_differentiable

from mgsr.checks import check_tensors
from mgsr.errors import TensorError
from mgsr.native import _image
from mgsr.native.cuda.image import ImageKernels
from mgsr.native.cuda.launcher import launcher_for
from mgsr.ops.arrays import mean, plain

Region = tuple[int, int, int, int]


def image_loss(
    image: torch.Tensor,
    target: torch.Tensor,
    l1_weight: float = 0.8,
    mask: torch.Tensor | None = None,
    region: Region | None = None,
) -> torch.Tensor:
    """Scalar ``l1_weight * L1 + (1 - l1_weight) * (1 - SSIM)``, means over all pixels and channels.

    image, target: [H, W, 3], colours 0..1; gradients flow to each that requires them.
    l1_weight: 0..1.
    mask: [H, W] weights >= 0 or None; both terms become sum(mask * x) / sum(mask). SSIM windows still read the pixels
        that the mask leaves out. A mask of zeros gives a loss of zero.
    region: (y0, y1, x0, x1), ends excluded: a promise that image and target are equal outside. Costs only the region's
        pixels; the loss is that of the whole image, the gradient outside the region is zero.

    SSIM: window of 11 taps, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2 (Wang et al. 2004). At equal pixels L1
    passes no gradient. A NaN pixel makes the loss NaN, and the gradient within 10 pixels of it. The same bytes come
    out for any thread count. Computed in the forward pass: backward only scales.

    Raises TensorError for wrong shapes or dtypes, a weight outside 0..1, or a region that leaves the image.
    Source: method, "Render loss".
    """
    sizes = check_tensors(image=(image, "H W 3"), target=(target, "H W 3"))
    if mask is not None:
        check_tensors(sizes, image=(image, "H W 3"), mask=(mask, "H W"))
    if not 0 <= l1_weight <= 1:
        raise TensorError(f"l1_weight: expected 0..1, got {l1_weight}")
    whole = (0, sizes["H"], 0, sizes["W"])
    y0, y1, x0, x1 = region or whole
    if not (0 <= y0 <= y1 <= sizes["H"] and 0 <= x0 <= x1 <= sizes["W"]):
        raise TensorError(f"region: expected (y0, y1, x0, x1) inside {sizes['H']} x {sizes['W']}, got {region}")
    if not image.requires_grad and target.requires_grad:
        image, target = target, image  # the loss is symmetric, and the kernel's first gradient is the image's
    return _ImageLoss.apply(image, target, l1_weight, mask, (y0, y1, x0, x1), (y0, y1, x0, x1) == whole)


class _ImageLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        image: torch.Tensor,
        target: torch.Tensor,
        l1_weight: float,
        mask: torch.Tensor | None,
        region: Region,
        is_whole: bool,
    ) -> torch.Tensor:
        new = torch.empty if is_whole else torch.zeros
        v_image, v_target = (
            new(image.shape, device=image.device) if needed else None for needed in ctx.needs_input_grad[:2]
        )
        weights = None if mask is None else plain(mask)
        arguments = (plain(image), plain(target), l1_weight, weights, region, v_image, v_target)
        launcher = launcher_for(image)
        if launcher is None:
            loss, ctx.scale = mean(*_image.image_loss(*arguments))
        else:
            loss, ctx.scale = ImageKernels(launcher).image_loss(*arguments)
        ctx.save_for_backward(v_image, v_target)
        return loss

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_loss: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        scale = v_loss * ctx.scale
        v_image, v_target = (None if v is None else v * scale for v in ctx.saved_tensors)
        return v_image, v_target, None, None, None, None
