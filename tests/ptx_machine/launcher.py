"""Run kernels as NVRTC compiles them, on this machine's processor, with every access of memory watched."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import torch

from mgsr.errors import GpuError
from mgsr.native.cuda.compiler import SOURCES
from mgsr.native.cuda.params import Pointer
from tests.cuda_shim.launcher import Order
from tests.ptx_machine.library import Library, load_library


class _Range(ctypes.Structure):
    """The struct Range of machine/memory.h."""

    _fields_ = (("begin", ctypes.c_uint64), ("bytes", ctypes.c_uint64))


class _Launch(ctypes.Structure):
    """The struct Launch of machine/machine.h."""

    _fields_ = (
        ("kernel", ctypes.c_char_p),
        ("params", ctypes.c_void_p),
        ("params_bytes", ctypes.c_uint64),
        ("tensors", ctypes.POINTER(_Range)),
        ("tensor_count", ctypes.c_int32),
        ("blocks", ctypes.c_uint32),
        ("threads", ctypes.c_uint32),
        ("order", ctypes.c_int32),
        ("seed", ctypes.c_int32),
        ("noise_ulps", ctypes.c_int32),
    )


class PtxLauncher:
    """A mgsr.native.cuda.launcher.Launcher over tensors on the CPU, within its `noting_tensors`.

    Raises GpuError for what is wrong with a kernel: races, accesses outside of the tensors handed over, misaligned
    ones, misused barriers and warp operations, shared memory read before it was written. Messages name the lines.
    """

    def __init__(
        self,
        order: Order = Order.ASCENDING,
        seed: int = 0,
        noise_ulps: int = 0,
        sources: Path = SOURCES,
    ) -> None:
        """Set the order of threads and the exactness of instructions.

        noise_ulps: by how many units in the last place approximate instructions are off. sources: the folder that holds
        kernels/ and math/.
        """
        self.order, self.seed, self.noise_ulps = order, seed, noise_ulps
        self.launched: list[str] = []
        self._sources = sources
        self._sizes: dict[int, int] = {}

    @contextmanager
    def noting_tensors(self) -> Iterator[None]:
        """Note each tensor whose address is asked for within the block.

        Kernels may touch these, and no further than their sizes.
        """
        data_ptr = torch.Tensor.data_ptr

        def noted(tensor: torch.Tensor) -> int:
            address = data_ptr(tensor)
            self._sizes[address] = tensor.numel() * tensor.element_size()
            return address

        with mock.patch.object(torch.Tensor, "data_ptr", noted):
            yield

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        if not blocks:
            return
        self.launched.append(kernel)
        library = load_library(self._sources / "kernels" / family / f"{family}.cu", self._sources)
        self.run(library, kernel, blocks, threads, params)

    def run(self, library: Library, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        """Run a library's kernel as `launch` does."""
        ranges = [self._range(address) for address in pointers_in(params)]
        launch = _Launch(
            kernel.encode(),
            *(ctypes.addressof(params), ctypes.sizeof(params)),
            *((_Range * len(ranges))(*ranges), len(ranges)),
            *(blocks, threads, int(self.order), self.seed, self.noise_ulps),
        )
        wrong = _call(library.functions.ptx_launch, ctypes.byref(launch))
        unwritten = _call(library.functions.ptx_unwritten_reads)
        for message in (wrong, unwritten):
            if message is not None:
                raise GpuError(f"{kernel}: {explain(message, library)}")

    def _range(self, address: int) -> _Range:
        assert address in self._sizes, f"{address:#x} is the address of no tensor that was noted"
        return _Range(address, self._sizes[address])


def _call(function: Any, *arguments: Any) -> str | None:
    function.restype = ctypes.c_char_p
    result = function(*arguments)
    return None if result is None else result.decode()


def explain(message: str, library: Library) -> str:
    """Spell out the lines of PTX that a message names as {123}."""
    return re.sub(r"\{(\d+)\}", lambda match: library.places.describe(int(match[1])), message)


def pointers_in(params: ctypes.Structure) -> Iterator[int]:
    """Yield the addresses in a struct, its structs and arrays; null pointers left out."""
    for name, kind, *_ in params._fields_:
        yield from _pointers(getattr(params, name), kind)


def _pointers(value: Any, kind: Any) -> Iterator[int]:
    if issubclass(kind, Pointer):
        if value:
            yield value
    elif issubclass(kind, ctypes.Structure):
        yield from pointers_in(value)
    elif issubclass(kind, ctypes.Array):
        for element in value:
            yield from _pointers(element, kind._type_)
