"""The screen-space statistics of splats for densification, on a GPU."""

from __future__ import annotations

import ctypes

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Long, addresses, pointer, pointers
from mgsr.native.structs import SplatStatistics

THREADS = 256


class StatisticsParams(ctypes.Structure):
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
    statistics: SplatStatistics,
    v_means2d: Tensor,
    radii: Tensor,
    scale: tuple[float, float],
    bad: Tensor | None,
) -> None:
    """Add |v_means2d [N,2] * scale| to the sum of gradients, and 1 to `seen` where radii [N] > 0, in place.

    bad [] bool: if it is True, nothing is added to the sum.
    """
    count, arrays = len(statistics.seen), addresses(bad, *statistics)
    params = StatisticsParams(count, pointer(v_means2d), pointer(radii), *scale, *arrays)
    launcher.launch("statistics", "statistics_gather", -(-count // THREADS), THREADS, params)
