"""Print what is measured, where, and with which versions."""

from __future__ import annotations

import importlib.metadata as metadata
import os
import platform
import subprocess

from benchmarks.gpu_check.arguments import parser, require_gpu
from benchmarks.gpu_check.results import tell

PACKAGES = ("torch", "numpy", "cuda-core", "cuda-bindings", "nvidia-cuda-nvrtc", "gsplat", "plyfile", "pillow")
GPU = ("nvidia-smi", "--query-gpu=name,driver_version,memory.total,compute_cap", "--format=csv,noheader")
COMMIT = ("git", "log", "-1", "--format=commit %h of %cs")
CHANGES = ("git", "status", "--porcelain", "--untracked-files=no")


def main() -> None:
    args = parser(__doc__).parse_args()
    tell(answer(COMMIT) or f"commit {os.environ.get('COMMIT', 'unknown')}")
    changed = answer(CHANGES)
    if changed:
        tell(f"with changes to {len(changed.splitlines())} files")
    tell(f"GPU: {answer(GPU) or 'nvidia-smi does not answer'}")
    tell(f"{os.cpu_count()} CPU cores, Python {platform.python_version()}, {versions()}")
    require_gpu(args.device)
    from mgsr.native.cuda.compiler import headers_digest
    from mgsr.native.cuda.launcher import compiler_version, cuda_launcher

    tell(f"NVRTC {'.'.join(map(str, compiler_version()))}, kernels' headers {headers_digest().hex()[:12]}")
    if args.device == "cuda":
        cuda_launcher(0)
        tell("the launcher accepts the GPU")


def answer(words: tuple[str, ...]) -> str:
    """Return what a program prints; nothing where it is not there or fails."""
    try:
        return subprocess.run(words, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def versions() -> str:
    """Return the packages that matter, by their versions."""
    return ", ".join(f"{name} {version(name) or 'is not there'}" for name in PACKAGES)


def version(name: str) -> str | None:
    """Return a package's version, None without it."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    main()
