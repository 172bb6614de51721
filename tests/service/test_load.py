"""Many clients at once, while a job trains on the same machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.service.stack import LONG_OPTIONS, ROOT, TINY, Stack

ROUNDS, SECONDS = 4, 10.0
# The crowd begins earlier and ends later than what is measured.
MARGIN = 2.0
# In earnest the clients' programs run on machines of their own. Here they stand back where the job wants the same core
# (it runs at 5); what they wait for that counts as the service's slowness.
CROWD_NICE = 10


@dataclass
class Pace:
    """What happened in so many seconds of training: iterations; CPU seconds of each process of the service."""

    seconds: float
    iterations: int
    cpu: dict[str, float]

    def __add__(self, other: Pace) -> Pace:
        cpu = {name: self.cpu.get(name, 0.0) + other.cpu[name] for name in other.cpu}
        return Pace(self.seconds + other.seconds, self.iterations + other.iterations, cpu)

    def shares(self) -> str:
        """For a person: percent of a core that each process had."""
        return ", ".join(f"{name} {used / self.seconds:.1%}" for name, used in self.cpu.items())


def watch(stack: Stack, job: str, seconds: float) -> Pace:
    """How the training goes on for so many seconds."""
    before, begin = cpu_seconds(stack), stack.job(job)["curve"][-1]
    time.sleep(seconds)
    after, end = cpu_seconds(stack), stack.job(job)["curve"][-1]
    used = {name: after[name] - before[name] for name in after}
    return Pace(end["seconds"] - begin["seconds"], end["iteration"] - begin["iteration"], used)


def cpu_seconds(stack: Stack) -> dict[str, float]:
    """What each process has used so far."""
    processes = {name: process.pid for name, process in stack.processes.items()}
    (processes["job"],) = stack.job_processes()
    return {name: cpu_of(pid) for name, pid in processes.items()}


def cpu_of(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_three_hundred_who_poll_and_fifty_who_follow(tmp_path: Path, tiny_archive: bytes) -> None:
    """Windows with the crowd and without it take turns, so that what else happens on the machine hits both. Needs two
    cores that do nothing else: one trains, the other serves and asks."""
    settings = TINY | {"train.warmup.surfel_iterations": 1_000_000, "train.warmup.stop_rule": "none"}
    alone = together = Pace(0.0, 0, {})
    took: list[float] = []
    events: list[int] = []
    with Stack(tmp_path) as stack:
        job = stack.submitted(tiny_archive, LONG_OPTIONS | {"settings": settings})
        stack.wait_for(job, "running", step="train")
        time.sleep(5)
        seconds = str(SECONDS + 2 * MARGIN)
        crowd = ["nice", "-n", str(CROWD_NICE), sys.executable, "-m", "tests.service.crowd", str(stack.port), job]
        for _ in range(ROUNDS):
            alone += watch(stack, job, SECONDS)
            with subprocess.Popen([*crowd, seconds], stdout=subprocess.PIPE, text=True, cwd=ROOT) as clients:
                time.sleep(MARGIN)
                together += watch(stack, job, SECONDS)
                assert clients.stdout is not None
                found = json.loads(clients.stdout.read())
            took, events = took + found["took"], events + found["events"]
        stack.http.delete(f"/jobs/{job}")
        stack.wait_for(job, "cancelled", seconds=20)
    took.sort()
    p99 = took[int(0.99 * len(took))]
    paces = [pace.iterations / pace.seconds for pace in (alone, together)]
    slowed = 1 - paces[1] / paces[0]
    print(
        f"{len(took)} answers, median {took[len(took) // 2] * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, longest "
        f"{took[-1] * 1e3:.0f} ms; {paces[0]:.0f} iterations/s alone ({alone.shares()}), {paces[1]:.0f} with the crowd "
        f"({together.shares()}): slowed by {slowed:.1%}"
    )
    assert len(took) > 0.8 * 300 * SECONDS * ROUNDS
    assert min(events) >= 10
    assert p99 < 0.1
    assert slowed < 0.1
