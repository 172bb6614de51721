"""The conditions of a measurement: the program's commit, the machine, and how busy others kept it."""

from __future__ import annotations

import hashlib
import os
import platform
import resource
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import mgsr

# The paths that determine a run's results; changes of tests or pages leave figures valid.
COMPUTED_BY = ("mgsr", "CMakeLists.txt", ":(exclude)mgsr/bench", ":(exclude)mgsr/report", ":(exclude)mgsr/cli/bench.py")
ROOT = Path(mgsr.__file__).resolve().parents[1]


def program_commit() -> str:
    """Return the last commit that changed the results of runs.

    It has a plus and a mark of the changes where the checkout has uncommitted ones. Where the program is no checkout,
    its version is returned.
    """
    name = _git("log", "-1", "--format=%h", "--", *COMPUTED_BY).strip()
    if not name:
        return mgsr.__version__
    changes = _git("diff", "HEAD", "--", *COMPUTED_BY) + _git("status", "--porcelain", "--", *COMPUTED_BY)
    return name + (f"+{hashlib.sha256(changes.encode()).hexdigest()[:6]}" if changes else "")


def _git(*words: str) -> str:
    try:
        asked = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True)
    except FileNotFoundError:
        return ""
    return asked.stdout if asked.returncode == 0 else ""


def processor_name() -> str:
    """Return the CPU's name from the system, with the number of cores that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{_cpu_model()}, {cores} cores"


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@dataclass(frozen=True)
class Load:
    """The load of the machine during a measurement.

    wall: seconds; others: processors that programs other than this one's children kept busy, on average; None where the
    system does not tell.
    """

    wall: float
    others: float | None


class LoadWatch:
    """A watch of what others did with the machine while a child process ran."""

    def __init__(self) -> None:
        self._started_at, self._busy, self._own = time.monotonic(), _busy_seconds(), _children_seconds()

    def read(self) -> Load:
        """Return the load since the watch was made; the child must have ended."""
        wall, busy = time.monotonic() - self._started_at, _busy_seconds()
        if busy is None or self._busy is None:
            return Load(wall, None)
        own = _children_seconds() - self._own
        return Load(wall, max(0.0, busy - self._busy - own) / max(wall, 1e-3))


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _busy_seconds() -> float | None:
    """Return the processor seconds of all programs since the machine started."""
    stat = Path("/proc/stat")
    if not stat.is_file():
        return None
    user, nice, system, _, _, irq, soft_irq = (int(word) for word in stat.read_text().split()[1:8])
    return (user + nice + system + irq + soft_irq) / os.sysconf("SC_CLK_TCK")
