"""Read the GPU's counters for single kernels with ncu: how long they take, and how busy they keep its parts.

Where ncu can't (it is missing, or counters are for administrators alone), what it says is the result.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator

from benchmarks.gpu_check.arguments import parser, require_gpu, results_of
from benchmarks.gpu_check.results import tell

SECTIONS = ("SpeedOfLight", "LaunchStats", "Occupancy", "WarpStateStats", "MemoryWorkloadAnalysis")
# Of our own kernels, those that take most of an iteration, as ncu's --kernel-name has them.
WATCHED = (
    "regex:^("
    "gaussians_(project|blend_dual|backward_dual)|surfels_(blend|backward)_plain|image_loss|image_loss_gradient"
    ")$"
)
KERNEL = re.compile(r"^  (\w+) \(\d+, \d+, \d+\)x\(\d+, \d+, \d+\)")
METRIC = re.compile(r"^    (\S.*?)\s{2,}(\S+)\s+([\d.,]+)$")
# The metrics of the summary, by their names there.
TOLD = {
    "Duration": "takes",
    "Compute (SM) Throughput": "compute",
    "Memory Throughput": "memory",
    "Achieved Occupancy": "occupancy",
    "Registers Per Thread": "registers",
}


def main() -> None:
    args = parser(__doc__).parse_args()
    require_gpu(args.device)
    program = shutil.which("ncu")
    if program is None:
        raise SystemExit("ncu is not installed; skip the step with SKIP")
    words = [program, "--profile-from-start", "off", "--clock-control", "none", "--kernel-name-base", "function"]
    words += ["--kernel-name", WATCHED, *(word for section in SECTIONS for word in ("--section", section))]
    words += [sys.executable, "-m", "benchmarks.gpu_check.counted_kernels"]
    words += ["--results", str(args.results), "--work", str(args.work), "--device", args.device]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    assert process.stdout is not None
    found = read_metrics(shown(process.stdout))
    for kernel, metrics in found.items():
        results_of(args).row(step="ncu", kernel=kernel, metrics=metrics)
        tell(f"{kernel}: " + ", ".join(f"{name} {metrics[key]}" for key, name in TOLD.items() if key in metrics))
    if process.wait() or not found:
        raise SystemExit(f"ncu: exit code {process.returncode}, {len(found)} kernels (log.txt has what it says)")


def shown(lines: Iterable[str]) -> Iterator[str]:
    """Print the lines as they come, and yield them."""
    for line in lines:
        print(line, end="", flush=True)
        yield line


def read_metrics(lines: Iterable[str]) -> dict[str, dict[str, str]]:
    """Parse ncu's numbers with their units, by the kernel and the metric's name.

    Of a kernel that ran twice, the last run's are taken. Where two sections name a metric, the first one's stays.
    """
    found, metrics = dict[str, dict[str, str]](), dict[str, str]()
    for line in lines:
        kernel, metric = KERNEL.match(line), METRIC.match(line.rstrip())
        if kernel is not None:
            metrics = found[kernel[1]] = {}
        elif metric is not None:
            metrics.setdefault(metric[1], f"{metric[3]} {metric[2]}")
    return found


if __name__ == "__main__":
    main()
