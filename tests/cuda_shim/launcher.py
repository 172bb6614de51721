"""Run kernels of CUDA C++ on this machine's processor, under the shim of cuda_shim.h."""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
import tempfile
from enum import IntEnum
from functools import cache
from pathlib import Path

from mgsr.errors import GpuError
from mgsr.native.cuda.compiler import SOURCES, headers_digest

HERE = Path(__file__).resolve().parent
BUILD = HERE.parents[1] / "build" / "cuda_shim"
# No contraction of a * b + c behind the source's back: forward and backward must agree to the bit.
FLAGS = ("-std=c++17", "-O2", "-shared", "-fPIC", "-fno-gnu-unique", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")


class Order(IntEnum):
    """The order in which threads run between two barriers, and blocks among each other."""

    ASCENDING = 0
    DESCENDING = 1
    SHUFFLED = 2


class ShimLauncher:
    """A mgsr.native.cuda.launcher.Launcher over tensors on the CPU.

    Raises GpuError where a kernel misuses barriers.
    """

    def __init__(self, order: Order = Order.ASCENDING, seed: int = 0) -> None:
        self.order, self.seed = order, seed
        self.launched: list[str] = []

    def launch(self, family: str, kernel: str, blocks: int, threads: int, params: ctypes.Structure) -> None:
        library = load_library(family)
        expected = ctypes.c_size_t.in_dll(library, f"{kernel}_size").value
        assert expected == ctypes.sizeof(params), f"{kernel}: C has {expected} bytes, Python {ctypes.sizeof(params)}"
        most = ctypes.c_int.in_dll(library, f"{kernel}_threads").value
        assert threads <= most, f"{kernel}: declared for {most} threads, launched with {threads}"
        self.launched.append(kernel)
        run = library.shim_launch
        run.restype = ctypes.c_char_p
        error = run(getattr(library, kernel), ctypes.byref(params), blocks, threads, int(self.order), self.seed)
        if error is not None:
            raise GpuError(f"{kernel}: {error.decode()}")


@cache
def load_library(family: str) -> ctypes.CDLL:
    """Return the family's kernels, compiled by g++ unless build/ has them already."""
    return ctypes.CDLL(str(compile_with_shim(SOURCES / "kernels" / family / f"{family}.cu")), mode=os.RTLD_LOCAL)


def compile_with_shim(source: Path) -> Path:
    """Compile a .cu file's kernels to a shared library, and return its path.

    The name holds a hash of all that it depends on.
    """
    digest = hashlib.sha256(headers_digest() + source.read_bytes() + " ".join(FLAGS).encode())
    for header in sorted(HERE.glob("*.h")):
        digest.update(header.read_bytes())
    library = BUILD / f"{source.stem}-{digest.hexdigest()[:16]}.so"
    if not library.exists():
        BUILD.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=BUILD) as folder:
            partial = Path(folder) / library.name
            include = ["-I", str(SOURCES), "-I", str(HERE), "-include", str(HERE / "cuda_shim.h")]
            subprocess.run(["g++", *FLAGS, *include, "-x", "c++", str(source), "-o", str(partial)], check=True)
            os.replace(partial, library)
    return library
