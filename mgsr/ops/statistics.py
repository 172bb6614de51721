"""Screen-space statistics of a rendering's splats, for densification."""

from __future__ import annotations

import torch
from torch import Tensor

from mgsr.checks import check_tensors
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.cuda.statistics import gather
from mgsr.native.structs import SplatStatistics
from mgsr.ops.arrays import plain


def gather_gradients(
    gradient_sum: Tensor,
    seen: Tensor,
    v_means2d: Tensor,
    radii: Tensor,
    scale: tuple[float, float],
    bad: Tensor | None = None,
) -> None:
    """Add the gradient lengths of one image to gradient_sum [N], and count the splats that it shows in seen [N].

    Changes in place: gradient_sum [N] += the lengths of v_means2d [N,2] times `scale`; seen [N] += 1 where
    radii [N] > 0. bad [] bool, only on a GPU: whether the gradients count as zero.

    Raises TensorError for wrong shapes or dtypes, or tensors on different devices. No gradients flow.
    """
    check_tensors(gradient_sum=(gradient_sum, "N"), seen=(seen, "N"), v_means2d=(v_means2d, "N 2"), radii=(radii, "N"))
    launcher = launcher_for(seen)
    if launcher is not None:
        statistics = SplatStatistics(gradient_sum=gradient_sum, seen=seen)
        gather(launcher, statistics, plain(v_means2d), plain(radii), scale, bad)
        return
    gradient_sum += torch.hypot(v_means2d[:, 0] * scale[0], v_means2d[:, 1] * scale[1])
    seen += radii > 0
