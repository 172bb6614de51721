"""The host shim itself: it runs correct kernels, and shows races and misused barriers."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator

import pytest
import torch

from mgsr.errors import GpuError
from mgsr.native.cuda.params import Pointer, pointer
from tests.cuda_shim import launcher
from tests.cuda_shim.launcher import HERE, Order, ShimLauncher, compile_with_shim


class Params(ctypes.Structure):
    _fields_ = (("out", Pointer),)


@pytest.fixture(scope="module", autouse=True)
def misuse() -> Iterator[None]:
    library = ctypes.CDLL(str(compile_with_shim(HERE / "misuse.cu")), mode=os.RTLD_LOCAL)
    before = launcher.load_library
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launcher, "load_library", lambda family: library if family == "misuse" else before(family))
        yield


def run(kernel: str, order: Order) -> list[float]:
    out = torch.full((64,), torch.nan)
    ShimLauncher(order, seed=1).launch("misuse", kernel, 1, 64, Params(pointer(out)))
    return out.tolist()


@pytest.mark.parametrize("order", list(Order))
def test_barriers_and_warps_work(order: Order) -> None:
    assert run("reversed", order) == list(range(63, -1, -1))
    first, second = sum(range(32)), sum(range(32, 64))
    assert run("sums_of_warps", order) == [first + 10.0] * 32 + [second + 10.0] * 32


def test_a_race_shows_as_a_difference() -> None:
    results = {order: run("races", order) for order in Order}
    assert results[Order.ASCENDING] != results[Order.DESCENDING]


@pytest.mark.parametrize("kernel", ["leaves_early", "half_a_warp"])
def test_misuse_is_an_error(kernel: str) -> None:
    with pytest.raises(GpuError, match="deadlock"):
        run(kernel, Order.ASCENDING)
