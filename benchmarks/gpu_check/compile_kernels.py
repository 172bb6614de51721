"""Compile every family of CUDA kernels for the GPU, timed; without a GPU, for one that is named here."""

from __future__ import annotations

import time

from benchmarks.gpu_check.arguments import parser, require_gpu, results_of
from benchmarks.gpu_check.results import tell

WITHOUT_GPU = "sm_90"


def main() -> None:
    args = parser(__doc__).parse_args()
    require_gpu(args.device)
    import torch

    from mgsr.errors import GpuError
    from mgsr.native.cuda.compiler import SOURCES, arch_for, compile_family

    arch = arch_for(*torch.cuda.get_device_capability()) if args.device == "cuda" else WITHOUT_GPU
    results, seconds, failed = results_of(args), {}, []
    for path in sorted(SOURCES.glob("kernels/*/*.cu")):
        started_at = time.perf_counter()
        try:
            size = len(compile_family(path.stem, arch))
        except GpuError as error:
            print(error, flush=True)
            failed.append(path.stem)
            continue
        seconds[path.stem] = time.perf_counter() - started_at
        print(f"{path.stem} for {arch}: {size} bytes, {seconds[path.stem]:.2f} s", flush=True)
    results.row(step="kernels", arch=arch, seconds=seconds, failed=failed)
    tell(f"{len(seconds)} families for {arch} in {sum(seconds.values()):.1f} s (near 0: from the cache)")
    if failed:
        raise SystemExit(f"these do not compile: {', '.join(failed)}")


if __name__ == "__main__":
    main()
