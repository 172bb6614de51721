"""Threads: results in order, and libraries kept to one thread."""

from __future__ import annotations

import torch
from threadpoolctl import threadpool_info

from mgsr.parallel import map_ahead, one_library_thread


def test_results_come_in_order() -> None:
    assert list(map_ahead(lambda number: number**2, range(20), 3)) == [number**2 for number in range(20)]


def test_libraries_get_one_thread_inside_and_their_own_outside() -> None:
    def blas() -> dict[str, int]:
        return {each["filepath"]: each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    with one_library_thread():
        inside, of_torch = blas(), torch.get_num_threads()
    assert of_torch == 1
    assert set(inside.values()) == {1} and {"numpy", "scipy"} <= {name for path in inside for name in _packages(path)}
    before = torch.get_num_threads(), blas()
    with one_library_thread():
        pass
    assert (torch.get_num_threads(), blas()) == before


def _packages(path: str) -> set[str]:
    return {part.partition(".")[0] for part in path.split("/") if part.endswith(".libs")}
