"""Threads: results in order, and libraries kept to one thread."""

from __future__ import annotations

import torch
from threadpoolctl import threadpool_info, threadpool_limits

from mgsr.parallel import map_ahead, one_library_thread


def test_results_come_in_order() -> None:
    assert list(map_ahead(lambda number: number**2, range(20), 3)) == [number**2 for number in range(20)]


def test_libraries_get_one_thread_inside_and_their_own_outside() -> None:
    def blas() -> dict[str, int]:
        return {each["filepath"]: each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    of_torch = torch.get_num_threads()
    with threadpool_limits(2, "blas"):
        torch.set_num_threads(2)
        with one_library_thread():
            inside = torch.get_num_threads(), blas()
        outside = torch.get_num_threads(), blas()
    torch.set_num_threads(of_torch)
    assert inside == (1, dict.fromkeys(inside[1], 1))
    assert outside == (2, dict.fromkeys(inside[1], 2))
    assert {"numpy", "scipy"} <= {name for path in inside[1] for name in _packages(path)}


def _packages(path: str) -> set[str]:
    return {part.partition(".")[0] for part in path.split("/") if part.endswith(".libs")}
