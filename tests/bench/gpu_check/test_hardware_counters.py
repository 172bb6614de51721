"""The reader of ncu's output."""

from __future__ import annotations

import re

from benchmarks.gpu_check.hardware_counters import WATCHED, read_metrics
from mgsr.native.cuda.compiler import SOURCES

OUTPUT = """\
==PROF== Connected to process 7 (/usr/bin/python3)
==PROF== Profiling "gaussians_blend_dual": 0%....50%....100% - 8 passes
[7] python3@127.0.0.1
  gaussians_blend_dual (2500, 1, 1)x(256, 1, 1), Context 1, Stream 7, Device 0, CC 9.0
    Section: GPU Speed Of Light Throughput
    ----------------------- ----------- ------------
    Metric Name             Metric Unit Metric Value
    ----------------------- ----------- ------------
    Elapsed Cycles                cycle       12,345
    Memory Throughput                 %        45.67
    Duration                         us        34.56
    Compute (SM) Throughput           %        78.90
    ----------------------- ----------- ------------

    OPT   This kernel grid is too small to fill the available resources on this device, resulting in only 0.1 full

    Section: Launch Statistics
    Registers Per Thread             register/thread              48
    Section: Memory Workload Analysis
    Memory Throughput           Gbyte/s       912.34

  surfels_backward_plain (10, 1, 1)x(128, 1, 1), Context 1, Stream 7, Device 0, CC 9.0
    Duration                         ms         1.25
==ERROR== An error
"""


def test_metrics_by_kernel() -> None:
    found = read_metrics(OUTPUT.splitlines(keepends=True))
    assert found == {
        "gaussians_blend_dual": {
            "Elapsed Cycles": "12,345 cycle",
            "Memory Throughput": "45.67 %",
            "Duration": "34.56 us",
            "Compute (SM) Throughput": "78.90 %",
            "Registers Per Thread": "48 register/thread",
        },
        "surfels_backward_plain": {"Duration": "1.25 ms"},
    }
    assert read_metrics(["==ERROR== ERR_NVGPUCTRPERM - no permission for the counters\n"]) == {}


def test_the_kernels_that_are_watched_are_ours() -> None:
    names = re.findall(r"MGSR_KERNEL\((\w+),", "".join(file.read_text() for file in SOURCES.glob("kernels/*/*.cu")))
    watched = [name for name in names if re.match(WATCHED.removeprefix("regex:"), name)]
    assert len(watched) == 7
