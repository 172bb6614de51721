"""Where the CUDA kernels run in tests: the host shim with threads in several orders, and a card where there is one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
import torch

from mgsr.native.cuda.launcher import use_launcher
from tests.cuda_shim.launcher import Order, ShimLauncher


@dataclass(frozen=True)
class Machine:
    """A device for tensors, and the order of the shim's threads, or None on a card."""

    name: str
    device: torch.device
    order: Order | None

    @contextmanager
    def running(self) -> Iterator[None]:
        """Within the block, operations on `device` run as CUDA kernels; under the shim, torch.empty gives NaN and the
        largest integers, so that what reads before it writes comes to light."""
        if self.order is None:
            yield
            return
        torch.use_deterministic_algorithms(True)
        try:
            with use_launcher(ShimLauncher(self.order)):
                yield
        finally:
            torch.use_deterministic_algorithms(False)


CPU = torch.device("cpu")
SHIM = Machine("shim", CPU, Order.ASCENDING)
OTHER_ORDERS = (Machine("shim-descending", CPU, Order.DESCENDING), Machine("shim-shuffled", CPU, Order.SHUFFLED))
CARD = Machine("cuda", torch.device("cuda"), None)
PROCESSOR = Machine("processor", CPU, None)  # the CPU kernels, for tests that hold both to the same


def _mark(machine: Machine) -> object:
    no_card = pytest.mark.skipif(not torch.cuda.is_available(), reason="NEEDS AN NVIDIA CARD: none is usable by torch")
    return pytest.param(machine, id=machine.name, marks=[no_card] if machine is CARD else [])


MACHINES = [_mark(machine) for machine in (SHIM, CARD)]
EVERY_KERNEL = [_mark(machine) for machine in (PROCESSOR, SHIM, CARD)]
ALL_MACHINES = [_mark(machine) for machine in (SHIM, *OTHER_ORDERS, CARD)]
on_each_machine = pytest.mark.parametrize("machine", MACHINES)
on_every_kernel = pytest.mark.parametrize("machine", EVERY_KERNEL)
on_each_machine_and_order = pytest.mark.parametrize("machine", ALL_MACHINES)
