"""Where the CUDA kernels run in tests: the host shim with threads in several orders, the machine for PTX, which is
slower and sees more, and a GPU where there is one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch

from mgsr.native.cuda.compiler import SOURCES
from mgsr.native.cuda.launcher import use_launcher
from tests.cuda_shim.launcher import Order, ShimLauncher
from tests.ptx_machine.launcher import PtxLauncher
from tests.ptx_machine.nvrtc import missing_tools


@dataclass(frozen=True)
class Machine:
    """A device for tensors, and the order of threads.

    The order is that in which the threads of the shim or of the machine for PTX run, or None on a GPU.
    """

    name: str
    device: torch.device
    order: Order | None

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run operations on `device` as CUDA kernels within the block.

        Except on a GPU, torch.empty gives NaN and the largest integers, so that a kernel fails its test if it reads
        what it has not written.
        """
        if self.order is None:
            yield
            return
        torch.use_deterministic_algorithms(True)
        try:
            with self._launching(self.order):
                yield
        finally:
            torch.use_deterministic_algorithms(False)

    @contextmanager
    def _launching(self, order: Order) -> Iterator[None]:
        with use_launcher(ShimLauncher(order)):
            yield

    def ascending(self) -> Machine:
        """Return the machine of the same kind whose results those in any other order must have to the bit."""
        return self if self.order is None else replace(self, order=Order.ASCENDING)


@dataclass(frozen=True)
class PtxMachine(Machine):
    """A machine that executes what NVRTC emits, and refuses races and stray accesses.

    It skips, and says so, without NVRTC or g++. sources, noise_ulps: as PtxLauncher takes them.
    """

    sources: Path = SOURCES
    noise_ulps: int = 0

    @contextmanager
    def _launching(self, order: Order) -> Iterator[None]:
        if reason := missing_tools():
            pytest.skip(reason)
        launcher = PtxLauncher(order, noise_ulps=self.noise_ulps, sources=self.sources)
        with launcher.noting_tensors(), use_launcher(launcher):
            yield


CPU = torch.device("cpu")
SHIM = Machine("shim", CPU, Order.ASCENDING)
OTHER_ORDERS = (Machine("shim-descending", CPU, Order.DESCENDING), Machine("shim-shuffled", CPU, Order.SHUFFLED))
PTX = PtxMachine("ptx", CPU, Order.ASCENDING)
PTX_SHUFFLED = PtxMachine("ptx-shuffled", CPU, Order.SHUFFLED)
GPU = Machine("cuda", torch.device("cuda"), None)
PROCESSOR = Machine("processor", CPU, None)  # the CPU kernels, for tests that hold both to the same


def _mark(machine: Machine) -> object:
    no_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="NEEDS AN NVIDIA GPU: none is usable by torch")
    marks = {GPU: [no_gpu], PTX: [pytest.mark.slow], PTX_SHUFFLED: [pytest.mark.slow]}
    return pytest.param(machine, id=machine.name, marks=marks.get(machine, []))


MACHINES = [_mark(machine) for machine in (SHIM, PTX, GPU)]
EVERY_KERNEL = [_mark(machine) for machine in (PROCESSOR, SHIM, PTX, GPU)]
ALL_MACHINES = [_mark(machine) for machine in (SHIM, *OTHER_ORDERS, PTX, PTX_SHUFFLED, GPU)]
on_each_machine = pytest.mark.parametrize("machine", MACHINES)
on_every_kernel = pytest.mark.parametrize("machine", EVERY_KERNEL)
on_each_machine_and_order = pytest.mark.parametrize("machine", ALL_MACHINES)
