"""Edge-aware total variation with its gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch.autograd.function import once_differentiable

from mgsr.checks import check_tensors
from mgsr.native import _image
from mgsr.native.cuda.image import ImageKernels
from mgsr.native.cuda.launcher import launcher_for
from mgsr.ops.arrays import mean, plain


def edge_aware_tv(values: torch.Tensor, guide: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
    """Scalar: mean over all pairs of neighbours and channels of (difference)^2 * exp(-|difference of the guide|).

    The pairs of both axes form one mean; the guide's absolute difference is averaged over its channels.

    values: [H, W] or [H, W, C]; gradients flow. guide: [H, W, 3]; no gradient.
    mask: [H, W] weights >= 0 or None; a pair counts by the product of its pixels' weights, so that with zeros and ones
        only pairs count that lie inside with both pixels. Without a pair (one pixel, an empty mask) the result is 0.

    A NaN in values makes the result NaN; gradients are NaN at that pixel and its neighbours. Same bytes for any
    thread count.

    Raises TensorError for wrong shapes or dtypes.
    Source: method, "TV".
    """
    shape = "H W" if values.ndim == 2 else "H W C"
    sizes = check_tensors(values=(values, shape), guide=(guide, "H W 3"))
    if mask is not None:
        check_tensors(sizes, values=(values, shape), mask=(mask, "H W"))
    return _EdgeAwareTv.apply(values.unsqueeze(-1) if values.ndim == 2 else values, guide, mask)


class _EdgeAwareTv(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, guide: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
        v_values = torch.empty(values.shape, device=values.device) if ctx.needs_input_grad[0] else None
        arguments = (plain(values), plain(guide), None if mask is None else plain(mask), v_values)
        launcher = launcher_for(values)
        if launcher is None:
            total, pairs = _image.tv(*arguments)
            result, ctx.scale = mean(total, pairs * values.shape[2])
        else:
            result, ctx.scale = ImageKernels(launcher).tv(*arguments)
        ctx.save_for_backward(v_values)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, v_result: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (v_values,) = ctx.saved_tensors
        return v_values * (v_result * ctx.scale), None, None
