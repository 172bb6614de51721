"""Edge-aware total variation with its gradient."""

from __future__ import annotations

import torch

from mgsr.checks import check_tensors
from mgsr.native import _image
from mgsr.native.cuda.image import ImageKernels
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.terms import Sums
from mgsr.ops.arrays import plain
from mgsr.ops.terms import Slope, Term, Total, needs_gradient, scalar


def edge_aware_tv(values: torch.Tensor, guide: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
    """Return the value [] of `edge_aware_tv_term`; gradients flow.

    values [H,W] or [H,W,C], guide [H,W,3] and mask [H,W]: as in `edge_aware_tv_term`.
    """
    return scalar(edge_aware_tv_term(values, guide, mask))


def edge_aware_tv_term(values: torch.Tensor, guide: torch.Tensor, mask: torch.Tensor | None = None) -> Term:
    """Return the mean over pairs of neighbours and channels of (difference)^2 * exp(-|difference of the guide|).

    The pairs of both axes form one mean; the guide's absolute difference is averaged over its channels.

    values: [H, W] or [H, W, C]; gradients flow. guide: [H, W, 3]; no gradient.
    mask: [H, W] weights >= 0 or None. The weight of a pair is the product of its pixels' weights. With zeros and ones,
    only pairs with both pixels inside count. Without a pair (one pixel, an empty mask) the result is 0.

    A NaN in values makes the result NaN; gradients are NaN at that pixel and its neighbours. The result has the same
    bytes for any number of threads.

    Raises TensorError for wrong shapes or dtypes.
    Source: method, "TV".
    """
    shape = "H W" if values.ndim == 2 else "H W C"
    check_tensors(values=(values, shape), guide=(guide, "H W 3"), mask=(mask, "? H W"))
    launcher = launcher_for(values)
    v_values = torch.empty(values.shape, device=values.device) if needs_gradient(values)[0] else None
    channels = plain(values).view(*values.shape[:2], -1)
    slopes = None if v_values is None else v_values.view(channels.shape)
    arguments = (channels, plain(guide), None if mask is None else plain(mask), slopes)
    sums: Total | Sums
    if launcher is None:
        total, pairs = _image.tv(*arguments)
        sums = Total(total, pairs * channels.shape[2])
    else:
        sums = ImageKernels(launcher).tv(*arguments)
    return Term(sums, () if v_values is None else (Slope(values, v_values),))
