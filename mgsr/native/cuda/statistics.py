"""Screen-space statistics of each splat for densification, on the card."""

from __future__ import annotations

import ctypes

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Long, addresses, pointer, pointers

THREADS = 256


class Params(ctypes.Structure):
    """The struct StatisticsParams of kernels/statistics/statistics.cu."""

    _fields_ = (
        ("count", Long),
        *pointers("v_means2d", "radii"),
        ("scale_x", Float),
        ("scale_y", Float),
        *pointers("bad", "gradient_sum", "seen"),
    )


def gather(
    launcher: Launcher,
    gradient_sum: Tensor,
    seen: Tensor,
    v_means2d: Tensor,
    radii: Tensor,
    scale: tuple[float, float],
    bad: Tensor | None,
) -> None:
    """Add |v_means2d [N,2] * scale| to gradient_sum [N], and 1 to seen [N] where radii [N] > 0, in place.

    bad [] bool: nothing is added to gradient_sum where it is True.
    """
    arrays = addresses(bad, gradient_sum, seen)
    params = Params(len(seen), pointer(v_means2d), pointer(radii), *scale, *arrays)
    launcher.launch("statistics", "statistics_gather", -(-len(seen) // THREADS), THREADS, params)
