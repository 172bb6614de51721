"""Parallel work on several cores, the same for every view; and libraries kept to one thread."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import TypeVar

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")


def core_count(threads: int | None) -> int:
    """Return `threads`, or for None the number of cores that this process may use."""
    return threads or len(os.sched_getaffinity(0))


def map_ahead(work: Callable[[Item], Result], items: Iterable[Item], threads: int | None) -> Iterator[Result]:
    """Yield work(item) of each item, in order, computed ahead by `threads` threads.

    Threads suffice, as NumPy lets go of the interpreter in its loops. Only a few results are made ahead, so that they
    don't pile up in memory.
    """
    count = core_count(threads)
    with ThreadPoolExecutor(count) as pool:
        ahead: deque[Future[Result]] = deque()
        for item in items:
            ahead.append(pool.submit(work, item))
            if len(ahead) > count:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch use one thread inside the block, and as many as before outside.

    This holds in threads that are started inside, too. Where operations are small or cores are shared already, its idle
    threads would spin on the cores that others use.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Let torch, NumPy and SciPy use one thread inside the block, and as many as before outside.

    After each product of matrices, the idle threads of OpenBLAS spin on cores that others use.
    """
    from threadpoolctl import threadpool_limits  # imported here, because training needs no threadpoolctl

    import_module("scipy.linalg")  # loads SciPy's BLAS, which is not NumPy's
    with one_torch_thread(), threadpool_limits(1, "blas"):
        yield
