"""Compilation of kernel families with NVRTC, through the cache on disk."""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path
from typing import Any

from mgsr.errors import GpuError
from mgsr.native.cuda.kernel_cache import kernel_cache

SOURCES = Path(__file__).resolve().parents[1]
INSTALL = "install MGSR with its cuda extra: pip install 'mgsr[cuda]'"


def compile_family(family: str, arch: str, cache_dir: Path | None = None) -> bytes:
    """Return the machine code (cubin) of kernels/<family>/<family>.cu for an architecture such as sm_90.

    The code comes from the cache on disk if the same sources, options, architecture and NVRTC version were compiled
    before. If the cache can't be used, a warning says so once per process. cache_dir: `default_cache_dir()` by default.

    Raises GpuError if NVRTC is missing, doesn't know the architecture, or rejects the source.
    """
    try:
        from cuda.core import Program, ProgramOptions
        from cuda.core.utils import make_program_cache_key
    except ImportError as error:
        raise GpuError(f"cuda-core cannot be imported ({error}); {INSTALL}") from error
    if arch not in supported_archs():
        raise GpuError(f"{arch}: expected one of {', '.join(supported_archs())}, the architectures of this NVRTC")
    text = (SOURCES / "kernels" / family / f"{family}.cu").read_text()
    options = ProgramOptions(
        name=f"{family}.cu",
        arch=arch,
        std="c++17",
        include_path=str(SOURCES),
        device_as_default_execution_space=True,
    )
    key = make_program_cache_key(
        code=text, code_type="c++", options=options, target_type="cubin", extra_digest=headers_digest()
    )
    kept = kernel_cache(cache_dir or default_cache_dir())
    cubin = kept.get(key)
    if cubin is None:
        cubin = _compile(Program(text, "c++", options), family, arch)
        kept.put(key, cubin)
    return cubin


def supported_archs() -> list[str]:
    """Return the architectures that this NVRTC compiles for, oldest first.

    Raises GpuError without NVRTC.
    """
    try:
        from cuda.bindings import nvrtc

        _, archs = nvrtc.nvrtcGetSupportedArchs()
    except (ImportError, RuntimeError) as error:
        raise GpuError(f"NVRTC, NVIDIA's run-time compiler, cannot be loaded ({error}); {INSTALL}") from error
    return [f"sm_{arch}" for arch in sorted(archs)]


def arch_for(major: int, minor: int) -> str:
    """Return the architecture to compile for, given a GPU's compute capability.

    It is the GPU's own, or the nearest older one of the same major number. Raises GpuError if there is none.
    """
    archs = supported_archs()
    capable = [arch for arch in archs if arch[3:-1] == str(major) and int(arch[-1]) <= minor]
    if not capable:
        raise GpuError(
            f"this GPU has compute capability {major}.{minor}, but the installed NVRTC compiles for "
            f"{', '.join(archs)}; install a newer nvidia-cuda-nvrtc for a newer GPU, or use --device cpu for an "
            "older one"
        )
    return capable[-1]


def default_cache_dir() -> Path | None:
    """Return the folder of machine code: `MGSR_CUDA_CACHE`, or mgsr/cuda in the user's cache folder.

    Returns None if the user has no home folder.
    """
    if own := os.environ.get("MGSR_CUDA_CACHE"):
        return Path(own)
    try:
        of_user = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        return None
    return Path(of_user) / "mgsr" / "cuda"


@cache
def headers_digest() -> bytes:
    """Return a hash of every header that a kernel may include."""
    digest = hashlib.sha256()
    for path in sorted([*SOURCES.glob("math/**/*.h"), *SOURCES.glob("kernels/**/*.h")]):
        digest.update(path.relative_to(SOURCES).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.digest()


def _compile(program: Any, family: str, arch: str) -> bytes:
    try:
        return bytes(program.compile("cubin").code)
    except Exception as error:  # cuda-core's own class is private; its text holds the compiler's log
        raise GpuError(f"kernels/{family}/{family}.cu does not compile for {arch}: {error}") from error
