"""Run the kernels of a .cu file beside this one."""

from __future__ import annotations

import ctypes
from typing import Any

from mgsr.native.cuda.compiler import SOURCES
from mgsr.native.cuda.params import pointer
from tests.cuda_shim.launcher import Order
from tests.ptx_machine.launcher import PtxLauncher
from tests.ptx_machine.library import HERE, load_library


def run(
    source: str, kernel: str, blocks: int, threads: int, params: type, *arguments: Any, order: Order = Order.ASCENDING
) -> None:
    """Launch a kernel of tests/ptx_machine/<source>; of the arguments, tensors become pointers."""
    launcher = PtxLauncher(order)
    with launcher.noting_tensors():
        fields = [pointer(a) if hasattr(a, "data_ptr") else a for a in arguments]
        struct: ctypes.Structure = params(*fields)
        launcher.run(load_library(HERE / source, SOURCES), kernel, blocks, threads, struct)
