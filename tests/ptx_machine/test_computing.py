"""Warps, barriers, vector loads, tables and branches compute what NumPy does."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.typing import ArrayLike

from mgsr.native.cuda.params import Pointer
from tests.cuda_shim.launcher import Order
from tests.ptx_machine.nvrtc import missing_tools
from tests.ptx_machine.running import run


class Params(ctypes.Structure):
    _fields_ = (("out", Pointer), ("in", Pointer), ("counts", Pointer), ("doubles", Pointer))


@pytest.fixture(autouse=True)
def tools() -> None:
    if reason := missing_tools():
        pytest.skip(reason)


NUMBERS = np.random.default_rng(0).normal(size=256).astype(np.float32)
X = NUMBERS[:64]
LANE = np.arange(64) % 32
FIRST = np.arange(64) - LANE


class Results:
    def __init__(self, kernel: str, threads: int = 64, blocks: int = 1, order: Order = Order.ASCENDING) -> None:
        """Return what a kernel of computing.cu makes of NUMBERS."""
        out, counts = torch.full((512,), torch.nan), torch.full((512,), -1, dtype=torch.int32)
        doubles = torch.full((4,), torch.nan, dtype=torch.float64)
        arguments = (out, torch.from_numpy(NUMBERS), counts, doubles)
        run("computing.cu", kernel, blocks, threads, Params, *arguments, order=order)
        self.out, self.counts, self.doubles = out.numpy(), counts.numpy(), doubles.numpy()


def assert_rows(came: np.ndarray, *expected: np.ndarray) -> None:
    """Check rows of 64 numbers, one for each thread."""
    for row, want in enumerate(expected):
        np.testing.assert_array_equal(came[64 * row : 64 * row + 64], want, err_msg=f"row {row}")


def test_vector_loads() -> None:
    four = NUMBERS.reshape(64, 4)
    expected = np.stack([four[:, 0] + four[:, 2], four[:, 1] * four[:, 3]], axis=1)
    np.testing.assert_array_equal(Results("vector_loads").out[:128], expected.ravel())


def test_vector_stores() -> None:
    expected = X[::-1, None] * np.array([1, 2, 3, 4], np.float32)
    np.testing.assert_array_equal(Results("vector_stores").out[:256], expected.ravel())


@pytest.mark.parametrize("order", list(Order))
def test_shuffles(order: Order) -> None:
    part = LANE // 8 * 8
    assert_rows(
        Results("shuffles", order=order).out,
        X[FIRST + np.where(LANE < 3, LANE, LANE - 3)],
        X[FIRST + np.where(LANE + 5 > 31, LANE, LANE + 5)],
        X[FIRST + (LANE ^ 9)],
        X[FIRST + LANE * 7 % 32],
        X[FIRST + np.where(LANE % 8 < 3, LANE, LANE - 3)],
        X[FIRST + np.where(LANE % 8 + 3 > 7, LANE, LANE + 3)],
        X[FIRST + (LANE ^ 5)],
        X[FIRST + part + LANE % 5],
    )


def test_a_part_of_a_warp_shuffles() -> None:
    expected = np.where(np.arange(32) < 20, X[(np.arange(32) + 1) % 20], X[:32])
    np.testing.assert_array_equal(Results("half_warp", threads=32).out[:32], expected)


def bits(which: np.ndarray) -> int:
    """Return the word that has 32 truths as its bits."""
    return int(sum(1 << int(i) for i in np.flatnonzero(which)))


@pytest.mark.parametrize("order", list(Order))
def test_votes_and_reductions(order: Order) -> None:
    def of_warps(function: Callable[[np.ndarray], ArrayLike]) -> np.ndarray:
        """Return a function of a warp's threads, for each thread."""
        return np.concatenate([np.broadcast_to(function(np.arange(w, w + 32)), 32) for w in (0, 32)]).astype(np.int32)

    def words(values: ArrayLike) -> np.ndarray:
        return np.asarray(values, np.uint32).view(np.int32)

    assert_rows(
        Results("votes", order=order).counts,
        words([bits(X[first : first + 32] > 0) for first in FIRST]),
        of_warps(lambda t: (X[t] > 0).any()),
        of_warps(lambda t: (X[t] > 0).all()),
        words(
            [bits((first + np.arange(32)) % 5 == (first + lane) % 5) for first, lane in zip(FIRST, LANE, strict=True)]
        ),
        of_warps(lambda t: (t - 40).sum()),
        of_warps(lambda t: (t - 40).min()),
        of_warps(lambda t: (t ^ 21).max()),
        of_warps(lambda t: np.bitwise_xor.reduce(t * 77)),
    )


def test_all_lanes_match_or_not() -> None:
    first = np.arange(64) < 32
    assert_rows(Results("matches").counts, np.where(first, -1, 0), first.astype(np.int32))


@pytest.mark.parametrize("order", list(Order))
def test_barriers_count(order: Order) -> None:
    positive = X > 0
    counts = Results("counts_of_block", order=order).counts
    assert_rows(counts != 0, *(np.full(64, truth) for truth in (positive.any(), positive.any(), positive.all())))
    assert (counts[:64] == positive.sum()).all()


@pytest.mark.parametrize("order", list(Order))
def test_sums_of_blocks_in_doubles(order: Order) -> None:
    came = Results("sums_of_block", blocks=3, order=order).doubles
    total = (X.astype(np.float64) ** 2).sum()
    np.testing.assert_allclose(came[:3], total * np.array([1, 2, 3]), rtol=1e-15)
    assert np.isnan(came[3])


def test_tables() -> None:
    i = np.arange(64) % 8
    primes, squares = np.array([2, 3, 5, 7, 11, 13, 17, 19]), np.array([0, 1, 4, 9, 16, 25, 36, -49])
    np.testing.assert_array_equal(Results("tables").out[:64], primes[i] + squares[7 - i])


def test_local_arrays() -> None:
    of = {i * 5 % 16: i for i in range(16)}
    expected = X * np.array([of[t % 16] for t in range(64)], np.float32)
    np.testing.assert_array_equal(Results("local_arrays").out[:64], expected)


def test_branches() -> None:
    steps: list[Callable[[np.float32], np.float32]] = [
        lambda x: x + 1,
        lambda x: x * 3,
        lambda x: -x,
        lambda x: x * x,
        lambda x: x - 5,
        lambda x: np.float32(2) if x < 0 else x,
        lambda x: x * np.float32(0.5),
    ]
    expected = []
    for t, x in enumerate(X):
        for i in range(3):
            x = np.float32(steps[(t + i) % 7](x))
        expected.append(x)
    np.testing.assert_allclose(Results("branches").out[:64], expected, rtol=3e-7)  # with and without fused operations


def test_sines_of_large_arguments() -> None:
    large = (X * np.float32(1e6)).astype(np.float64)
    np.testing.assert_allclose(Results("sines").out[:64], np.sin(large), rtol=0, atol=2e-7)
