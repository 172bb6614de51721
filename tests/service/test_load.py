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

from tests.service.stack import LONG_OPTIONS, ROOT, STOPPED, TINY, Stack

ROUNDS, SECONDS = 4, 10.0
# The crowd begins earlier and ends later than what is measured.
MARGIN = 2.0
# The clients' programs stand back where the job wants the same core (it runs at 5); what they wait for that counts as
# the service's slowness.
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

    @property
    def per_second(self) -> float:
        """Return the iterations per second of training."""
        return self.iterations / self.seconds

    def shares(self) -> str:
        """Return for people the percentage of a core that each process had."""
        return ", ".join(f"{name} {used / self.seconds:.1%}" for name, used in self.cpu.items())


def watch(stack: Stack, job: str, seconds: float) -> Pace:
    """Measure the training for so many seconds."""
    before, begin = cpu_seconds(stack), stack.job(job)["curve"][-1]
    time.sleep(seconds)
    after, end = cpu_seconds(stack), stack.job(job)["curve"][-1]
    used = {name: after[name] - before[name] for name in after}
    return Pace(end["seconds"] - begin["seconds"], end["iteration"] - begin["iteration"], used)


def cpu_seconds(stack: Stack) -> dict[str, float]:
    """Return the CPU seconds that each process has used so far."""
    processes = {name: process.pid for name, process in stack.processes.items()}
    (processes["job"],) = stack.job_processes()
    return {name: cpu_of(pid) for name, pid in processes.items()}


def cpu_of(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def beside(*command: str) -> subprocess.Popen[str]:
    """Start a program that runs beside the training for longer than a window."""
    return subprocess.Popen(
        ["nice", "-n", str(CROWD_NICE), sys.executable, "-m", *command, str(SECONDS + 2 * MARGIN)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def said(program: subprocess.Popen[str]) -> str:
    """Return what a program prints, once it has ended."""
    return program.communicate()[0]


def pace_beside(program: subprocess.Popen[str], stack: Stack, job: str) -> Pace:
    """Measure the training while the program runs."""
    time.sleep(MARGIN)
    return watch(stack, job, SECONDS)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_three_hundred_who_poll_and_fifty_who_follow(tmp_path: Path, tiny_archive: bytes) -> None:
    """Check that a crowd of clients slows the training little.

    Three kinds of windows take turns, so that what else happens on the machine affects all: the training alone; with
    the crowd; and with a program that takes as much CPU as the crowd does, but asks for nothing.

    In practice the clients run on machines of their own, so what the crowd itself takes of this machine's cores is not
    the service's cost. The service slows the training by what is lost between the third kind and the second. The loss
    between the first and the second, with the clients' own work, is printed too. Needs two idle cores: one trains, the
    other serves and asks.
    """
    settings = TINY | {"train.warmup.surfel_iterations": 1_000_000, "train.paper.stop_rule": "none"}
    alone = crowded = burdened = Pace(0.0, 0, {})
    took: list[float] = []
    events: list[int] = []
    shares: list[float] = []
    with Stack(tmp_path) as stack:
        job = stack.submitted(tiny_archive, LONG_OPTIONS | {"settings": settings})
        stack.wait_for(job, "running", step="train")
        time.sleep(5)
        for _ in range(ROUNDS):
            alone += watch(stack, job, SECONDS)
            clients = beside("tests.service.crowd", str(stack.port), job)
            crowded += pace_beside(clients, stack, job)
            found = json.loads(said(clients))
            took, events, shares = took + found["took"], events + found["events"], [*shares, found["share"]]
            stand_in = beside("tests.service.burn", str(found["share"]))
            burdened += pace_beside(stand_in, stack, job)
            said(stand_in)
        stack.http.delete(f"/jobs/{job}")
        stack.wait_for(job, "cancelled", seconds=STOPPED)
    took.sort()
    p99 = took[int(0.99 * len(took))]
    by_service, by_all = (1 - crowded.per_second / other.per_second for other in (burdened, alone))
    print(
        f"{len(took)} answers, median {took[len(took) // 2] * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, longest "
        f"{took[-1] * 1e3:.0f} ms; the clients took {sum(shares) / ROUNDS:.1%} of a core\n"
        f"{alone.per_second:.0f} iterations/s alone ({alone.shares()})\n"
        f"{burdened.per_second:.0f} beside a program that takes as much as the clients ({burdened.shares()})\n"
        f"{crowded.per_second:.0f} with the crowd ({crowded.shares()})\n"
        f"slowed by {by_service:.1%} by the service, by {by_all:.1%} with the clients' own work on the same cores"
    )
    assert len(took) > 0.8 * 300 * SECONDS * ROUNDS
    assert min(events) >= 10
    assert p99 < 0.1
    assert by_service < 0.1
