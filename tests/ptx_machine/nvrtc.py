"""Compile kernels to PTX with NVRTC, as mgsr/native/cuda/compiler.py has them compiled for a GPU."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from mgsr.errors import GpuError
from mgsr.native.cuda.compiler import supported_archs

ARCH = "sm_90"


def missing_tools() -> str | None:
    """Return what this machine lacks for compiling and executing PTX; None where nothing is."""
    if shutil.which("g++") is None:
        return "NEEDS g++: install a C++ compiler"
    try:
        supported_archs()
    except GpuError as error:
        return f"NEEDS NVRTC: {error}"
    return None


def options(sources: Path, arch: str) -> list[str]:
    """Return a GPU's options, and line numbers, which change no instruction."""
    return [
        f"-arch={arch}",
        f"--include-path={sources}",
        "--std=c++17",
        "--device-as-default-execution-space",
        "--generate-line-info",
    ]


def compile_to_ptx(source: Path, sources: Path, arch: str = ARCH) -> str:
    """Compile a .cu file that includes headers from the folder `sources`, and return the PTX.

    In it, files are named from that folder on. Raises GpuError with NVRTC's log.
    """
    from cuda.bindings import nvrtc

    program = _ask(nvrtc.nvrtcCreateProgram(source.read_bytes(), source.name.encode(), 0, [], []))
    given = [option.encode() for option in options(sources, arch)]
    (status,) = nvrtc.nvrtcCompileProgram(program, len(given), given)
    if int(status) != 0:
        size = _ask(nvrtc.nvrtcGetProgramLogSize(program))
        log = bytes(size)
        _ask(nvrtc.nvrtcGetProgramLog(program, log))
        raise GpuError(f"{source.name} does not compile for {arch}: {log.decode(errors='replace')}")
    ptx = bytes(_ask(nvrtc.nvrtcGetPTXSize(program)))
    _ask(nvrtc.nvrtcGetPTX(program, ptx))
    return ptx.rstrip(b"\0").decode().replace(f'"{sources}/', '"').replace(f'"{Path.cwd()}/', '"')


def _ask(result: tuple[Any, ...]) -> Any:
    status, *values = result
    if int(status) != 0:
        raise GpuError(f"NVRTC failed: {status!r}")
    return values[0] if values else None
