"""Build the CPU kernels where they are missing: cmake, ninja, nanobind and a C++ compiler are needed then."""

from __future__ import annotations

import subprocess
import sys
import time

from benchmarks.gpu_check.arguments import parser, work_of
from benchmarks.gpu_check.results import tell

LOADS = (sys.executable, "-c", "import mgsr.native.runtime")


def main() -> None:
    args = parser(__doc__).parse_args()
    if subprocess.run(LOADS, stderr=subprocess.DEVNULL, check=False).returncode == 0:
        print("the CPU kernels exist")
        return
    started_at, folder = time.perf_counter(), str(work_of(args) / "cmake")
    configure = ["cmake", "-S", ".", "-B", folder, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release"]
    for words in ([*configure, f"-DPython_EXECUTABLE={sys.executable}"], ["cmake", "--build", folder], LOADS):
        code = subprocess.run(words, check=False).returncode
        if code:
            raise SystemExit(f"{words[0]}: exit code {code}")
    tell(f"the CPU kernels were built in {time.perf_counter() - started_at:.0f} s")


if __name__ == "__main__":
    main()
