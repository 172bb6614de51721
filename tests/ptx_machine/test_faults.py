"""Each kind of fault in a kernel is refused with a message that names it, and the kernel without it is not."""

from __future__ import annotations

import ctypes

import pytest
import torch

from mgsr.errors import GpuError
from mgsr.native.cuda.params import Int, Pointer
from tests.cuda_shim.launcher import Order
from tests.ptx_machine.nvrtc import missing_tools
from tests.ptx_machine.running import run


class Params(ctypes.Structure):
    _fields_ = (("out", Pointer), ("in", Pointer), ("other", Pointer), ("offset", Int))


@pytest.fixture(autouse=True)
def tools() -> None:
    if reason := missing_tools():
        pytest.skip(reason)


def launch(
    kernel: str, blocks: int = 1, threads: int = 64, offset: int = 0, order: Order = Order.ASCENDING
) -> list[float]:
    """Launch a kernel, and return what comes out of 64 numbers 0, 1, 2, ..."""
    out, numbers, other = torch.full((64,), torch.nan), torch.arange(64.0), torch.zeros(64)
    run("faults.cu", kernel, blocks, threads, Params, out, numbers, other, offset, order=order)
    return out.tolist()


REVERSED = [float(i) for i in range(63, -1, -1)]
IN_WARPS = [float(i ^ 31) for i in range(64)]


@pytest.mark.parametrize("order", list(Order))
@pytest.mark.parametrize(
    ("kernel", "expected"),
    [
        ("shared_ordered", REVERSED),
        ("overwritten_ordered", [float((i + 3) % 64) for i in range(64)]),
        ("global_ordered", REVERSED),
        ("warp_ordered", IN_WARPS),
        ("global_read", [float(i) for i in range(64)]),
        ("global_write", [float(i) for i in range(64)]),
        ("shared_read", REVERSED),
        ("shared_write", REVERSED),
    ],
)
def test_right_kernels_pass(kernel: str, expected: list[float], order: Order) -> None:
    assert launch(kernel, order=order) == expected


@pytest.mark.parametrize(
    ("kernel", "blocks", "threads", "count"),
    [
        ("half_ordered", 1, 32, 32),
        ("blocks_apart", 2, 32, 64),
        ("local_write", 1, 64, 64),
        ("global_vector", 1, 8, 8),
        ("shared_vector", 1, 8, 8),
    ],
)
def test_right_kernels_of_other_sizes_pass(kernel: str, blocks: int, threads: int, count: int) -> None:
    written = launch(kernel, blocks, threads)
    assert all(x == x for x in written[:count]) and all(x != x for x in written[count:])


@pytest.mark.parametrize("order", list(Order))
@pytest.mark.parametrize(
    ("kernel", "blocks", "threads", "message"),
    [
        ("shared_race", 1, 64, "race: (read|write) of shared memory .*not ordered after the (read|write)"),
        ("overwritten_race", 1, 64, "race: (write of shared .*after the read|read of shared .*after the write)"),
        ("global_race", 1, 64, "race: (read|write) of global memory .*not ordered after the (read|write)"),
        (
            "blocks_race",
            2,
            32,
            r"race: write of global memory .*not ordered after the write .* after block \d",
        ),
        ("blocks_race_after_barrier", 2, 32, "race: (read|write) of global memory"),
        ("warp_race", 1, 64, "race: (read|write) of shared memory .*not ordered after the (read|write)"),
        ("half_race", 1, 32, "race: (read|write) of shared memory .*not ordered after the (read|write)"),
        ("exited_lanes", 1, 32, "warp operation .*names lane 7, which has left the kernel"),
        ("diverged_lanes", 1, 32, "warp operation .*which has diverged and is in another"),
        ("lanes_at_a_barrier", 1, 32, "warp operation .*diverged and wait at a barrier"),
        ("not_in_own_mask", 1, 32, "warp operation .*not in its own mask"),
        ("different_masks", 1, 32, "warp operation .*which has another mask"),
        ("reads_from_outside_the_mask", 1, 32, "warp operation .*reads from lane .*, which its mask leaves out"),
        ("lanes_that_are_not_there", 1, 40, "warp operation .*lanes that the block lacks"),
        ("left_before_a_barrier", 1, 64, "divergent barrier: .*waits for thread 5, which has left"),
        ("different_barriers", 1, 64, "divergent barrier: .*wait at different ones"),
        ("unwritten", 1, 64, "uninitialised: read of shared memory that nothing wrote"),
        ("traps", 1, 64, "trap"),
    ],
)
def test_a_fault_is_named(kernel: str, blocks: int, threads: int, message: str, order: Order) -> None:
    with pytest.raises(GpuError, match=f"{kernel}: {message}"):
        launch(kernel, blocks, threads, order=order)


@pytest.mark.parametrize(
    ("kernel", "threads", "offset", "message"),
    [
        ("global_read", 64, 1, "out of bounds: read of 4 bytes of global memory"),
        ("global_read", 64, -1, "out of bounds: read of 4 bytes of global memory"),
        ("global_write", 64, 1, "out of bounds: write of 4 bytes of global memory"),
        ("shared_read", 64, 1, "out of bounds: read of 4 bytes of shared memory"),
        ("shared_read", 64, -1, "out of bounds: read of 4 bytes of shared memory"),
        ("shared_write", 64, 1, "out of bounds: write of 4 bytes of shared memory"),
        ("shared_write", 64, 5000, "out of bounds: write of 4 bytes of shared memory"),
        ("local_write", 64, 1, "out of bounds: write of 4 bytes of local memory"),
        ("global_vector", 8, 1, "misaligned: access of 16 bytes of global memory"),
        ("shared_vector", 8, 1, "misaligned: access of 8 bytes of shared memory"),
    ],
)
def test_a_stray_access_is_named(kernel: str, threads: int, offset: int, message: str) -> None:
    with pytest.raises(GpuError, match=f"{kernel}: {message}"):
        launch(kernel, 1, threads, offset)


def test_a_sync_orders_nothing_for_other_lanes() -> None:
    with pytest.raises(GpuError, match="race: read of shared memory"):
        launch("reads_of_another_half", threads=32)


def test_messages_name_the_place() -> None:
    with pytest.raises(GpuError, match=r"PTX line \d+ `ld\.shared\.f32 .*;` of faults\.cu:\d+ .*\(block 0, thread \d+"):
        launch("shared_race")


def test_a_launch_that_does_not_fit_is_refused() -> None:
    with pytest.raises(GpuError, match="declared for 1 to 32 threads a block, launched with 64"):
        launch("blocks_apart", 1, 64)

    class Short(ctypes.Structure):
        _fields_ = (("out", Pointer),)

    with pytest.raises(GpuError, match="expected 32 bytes of parameters, got 8"):
        run("faults.cu", "shared_ordered", 1, 64, Short, torch.zeros(64))
    with pytest.raises(GpuError, match="no kernel of that name"):
        launch("not_there")
