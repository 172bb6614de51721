"""Kernels as libraries of this machine: NVRTC makes PTX, translator.py C++, g++ a library, which build/ keeps."""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mgsr.native.cuda.launcher import compiler_version
from tests.ptx_machine.nvrtc import ARCH, compile_to_ptx, options
from tests.ptx_machine.ptx import Places
from tests.ptx_machine.translator import translate

HERE = Path(__file__).resolve().parent
BUILD = HERE.parents[1] / "build" / "ptx_machine"
# No contraction: what is fused is what NVRTC fused.
FLAGS: tuple[str, ...] = (
    "-std=c++17",
    "-O1",
    "-shared",
    "-fPIC",
    "-fno-gnu-unique",
    "-ffp-contract=off",
    "-frounding-math",
)
FLAGS += ("-Wall", "-Wextra", "-Wfloat-conversion", "-Werror", "-Wno-unused-label")
TRANSLATOR = ("ptx", "operands", "arithmetic", "selections", "accesses", "meetings", "flow", "translator")


@dataclass(frozen=True)
class Library:
    """A .cu file's kernels, loaded, and where each line of their PTX comes from."""

    functions: ctypes.CDLL
    places: Places


@cache
def load_library(source: Path, sources: Path, arch: str = ARCH) -> Library:
    """Return the kernels of a .cu file, whose headers lie in the folder `sources`.

    Raises GpuError where NVRTC rejects it, and PtxError where the machine doesn't know an instruction.
    """
    return load_ptx(ptx_of(source, sources, arch), source.stem)


def load_ptx(ptx: str, name: str) -> Library:
    """Return the kernels of a PTX text.

    name: what its library is called.
    """
    return Library(ctypes.CDLL(str(library_of(ptx, name)), mode=os.RTLD_LOCAL), Places.of(ptx))


def ptx_of(source: Path, sources: Path, arch: str = ARCH) -> str:
    """Return the file's PTX, compiled unless build/ has that of the same source, headers, options and NVRTC."""
    headers = [(path.relative_to(sources).as_posix(), path.read_text()) for path in sorted(sources.rglob("*.h"))]
    compiler = (compiler_version(), options(Path("sources"), arch), (HERE / "nvrtc.py").read_text())
    digest = _digest(source.read_text(), headers, compiler)
    kept = BUILD / f"{source.stem}-{arch}-{digest}.ptx"
    if not kept.exists():
        _write_whole(kept, lambda partial: partial.write_text(compile_to_ptx(source, sources, arch)))
    return kept.read_text()


def library_of(ptx: str, name: str) -> Path:
    """Return a shared library of a PTX text's kernels, compiled unless build/ has that of the same PTX and machine."""
    machine = [(path.name, path.read_text()) for path in _machine_files()]
    library = BUILD / f"{name}-{_digest(ptx, machine, FLAGS)}.so"
    if not library.exists():
        code = translate(ptx)
        _write_whole(library, lambda partial: _compile(code, partial))
    return library


def _machine_files() -> list[Path]:
    """Return what decides over the library that a PTX text becomes."""
    return sorted([*(HERE / f"{name}.py" for name in TRANSLATOR), *HERE.glob("machine/*.h")])


def _digest(*parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def _compile(code: str, library: Path) -> None:
    source = library.with_suffix(".cpp")
    source.write_text(code)
    subprocess.run(["g++", *FLAGS, "-I", str(HERE / "machine"), str(source), "-o", str(library)], check=True)
    source.unlink()


def _write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file that appears under its name complete or not at all: other processes may make the same one."""
    BUILD.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=BUILD) as folder:
        partial = Path(folder) / path.name
        write(partial)
        os.replace(partial, path)
