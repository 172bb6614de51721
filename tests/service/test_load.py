"""Many clients at once, while a job trains on the same machine."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.service.stack import LONG_OPTIONS, ROOT, TINY, Stack

SECONDS = 20.0


def iterations(stack: Stack, job: str, seconds: float) -> float:
    """The training's iterations a second, over so many seconds."""

    def place() -> tuple[float, int]:
        row = stack.job(job)["curve"][-1]
        return row["seconds"], row["iteration"]

    begin = place()
    time.sleep(seconds)
    end = place()
    return (end[1] - begin[1]) / (end[0] - begin[0])


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_three_hundred_who_poll_and_fifty_who_follow(tmp_path: Path, tiny_archive: bytes) -> None:
    """Needs a machine that does nothing else: one of its cores trains, the others serve and ask."""
    settings = TINY | {"train.warmup.surfel_iterations": 1_000_000, "train.warmup.stop_rule": "none"}
    with Stack(tmp_path) as stack:
        job = stack.submitted(tiny_archive, LONG_OPTIONS | {"settings": settings})
        stack.wait_for(job, "running", step="train")
        time.sleep(5)
        alone = [iterations(stack, job, SECONDS)]
        command = [sys.executable, "-m", "tests.service.crowd", str(stack.port), job, str(SECONDS + 4)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as crowd:
            time.sleep(2)
            together = iterations(stack, job, SECONDS)
            assert crowd.stdout is not None
            found = json.loads(crowd.stdout.read())
        alone.append(iterations(stack, job, SECONDS))
        stack.http.delete(f"/jobs/{job}")
        stack.wait_for(job, "cancelled", seconds=20)
    took = found["took"]
    p99 = took[int(0.99 * len(took))]
    slowed = 1 - together / (sum(alone) / 2)
    print(
        f"{len(took)} answers, median {took[len(took) // 2] * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, "
        f"longest {took[-1] * 1e3:.0f} ms; {alone[0]:.0f} and {alone[1]:.0f} iterations/s alone, {together:.0f} with "
        f"the crowd: slowed by {slowed:.1%}"
    )
    assert len(took) > 0.8 * 300 * SECONDS
    assert min(found["events"]) >= 10
    assert p99 < 0.1
    assert slowed < 0.1
