"""Build gsplat for the GPU, and keep the build for later steps: gsplat.json says what they need to import it.

From the wheel that was brought, or as the interpreter has it. A small picture by each of its functions shows that the
build works. It takes minutes.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

from benchmarks.gpu_check.arguments import parser, require_gpu, work_of
from benchmarks.gpu_check.results import tell
from benchmarks.gpu_check.wheels import unpack_wheel

SMALL = "1k/64"


def main() -> None:
    made = parser(__doc__)
    made.add_argument("--wheel", type=Path)
    args = made.parse_args()
    require_gpu(args.device)
    work = work_of(args)
    # With other settings, torch would build anew where gsplat is imported.
    needed = compiler_settings() | {"TORCH_EXTENSIONS_DIR": str(work / "torch_extensions")}
    if args.wheel is not None:
        needed["PYTHONPATH"] = str(work / "gsplat")
        unpack_wheel(args.wheel, work / "gsplat")
    os.environ.update({name: value for name, value in needed.items() if name != "PYTHONPATH"})
    started_at = time.perf_counter()
    render_small(args.device, needed.get("PYTHONPATH"))
    (work / "gsplat.json").write_text(json.dumps(needed))
    tell(f"gsplat was built in {time.perf_counter() - started_at:.0f} s")


def compiler_settings() -> dict[str, str]:
    """Return the compiler's settings: for this GPU alone, beside other work.

    CUDA 13's toolkit keeps headers in a folder of their own, which is among them.
    """
    import torch

    cores = os.cpu_count() or 1
    settings = {"MAX_JOBS": str(max(1, cores - 4)), "VERBOSE": "1"}
    if torch.cuda.is_available():
        major, minor = torch.cuda.get_device_capability()
        settings["TORCH_CUDA_ARCH_LIST"] = f"{major}.{minor}"
    toolkit = os.environ.get("CUDA_HOME", "/usr/local/cuda")
    headers = Path(toolkit, "include", "cccl")
    if headers.is_dir():
        settings["CPATH"] = os.pathsep.join(filter(None, [str(headers), os.environ.get("CPATH")]))
    return settings


def render_small(device: str, package: str | None) -> None:
    """Render a small picture forward and backward with each of gsplat's functions.

    Raises SystemExit where gsplat can't be used.
    """
    import sys

    if package is not None:
        sys.path.insert(0, package)
    import torch

    try:
        from benchmarks import rasterizers
    except ImportError as error:
        raise SystemExit(f"the benchmark cannot be imported: {error}") from error
    modes = rasterizers.gsplat_modes(rasterizers.make_scene(SMALL, torch.device(device)))
    if not modes:
        raise SystemExit("gsplat cannot be imported, and its wheel was not packed (scripts/gpu_pack.sh)")
    for mode, render in modes.items():
        spent = rasterizers.time_once(render, torch.device(device))
        print(f"{mode}: {sum(spent):.1f} ms for the first run", flush=True)


if __name__ == "__main__":
    main()
