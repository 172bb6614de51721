"""Cancel in every state, and retry after it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.service.stack import LONG_OPTIONS, STOPPED, TINY, TINY_OPTIONS, Stack

SEEN = 2.0


@pytest.fixture
def busy(stack: Stack, tiny_archive: bytes) -> Iterator[str]:
    """Submit a job that trains for minutes, and cancel it at the end if it is not cancelled yet."""
    job = stack.submitted(tiny_archive, LONG_OPTIONS)
    stack.wait_for(job, "running", step="train")
    yield job
    stack.http.delete(f"/jobs/{job}")
    stack.wait_for(job, "cancelled", seconds=STOPPED)


def test_while_it_trains(stack: Stack, busy: str) -> None:
    """Check that the worker sees a cancel within two seconds, and that the process writes a checkpoint first.

    The job counts as cancelled only once the process is gone.
    """
    assert stack.job_processes()
    asked = time.monotonic()
    answer = stack.http.delete(f"/jobs/{busy}")
    assert answer.status_code == 202 and answer.json()["cancelling"]
    while f"job {busy}: stopping: cancelled" not in stack.logs():
        assert time.monotonic() - asked < SEEN, stack.logs()
        time.sleep(0.02)
    stack.wait_for(busy, "cancelled", seconds=STOPPED)
    assert not stack.job_processes()
    again = stack.http.delete(f"/jobs/{busy}")
    assert again.status_code == 200 and again.json()["status"] == "cancelled"


def test_while_it_waits(tmp_path: Path, tiny_archive: bytes) -> None:
    with Stack(tmp_path, workers=0) as idle:
        jobs = [idle.submitted(tiny_archive, TINY_OPTIONS) for _ in range(2)]
        assert [(idle.job(job)["status"], idle.job(job)["queue_position"]) for job in jobs] == [
            ("queued", 1),
            ("queued", 2),
        ]
        answer = idle.http.delete(f"/jobs/{jobs[0]}")
        assert answer.status_code == 200 and answer.json()["status"] == "cancelled"
        assert idle.http.get(f"/jobs/{jobs[0]}/mesh.ply").json()["code"] == "no_results"
        again = idle.http.post(f"/jobs/{jobs[0]}/retry")
        assert again.status_code == 202 and again.json()["status"] == "queued" and again.json()["round"] == 1


@pytest.mark.slow
def test_as_soon_as_a_worker_has_it(stack: Stack, tiny_archive: bytes) -> None:
    """Check that a job is killed at once, before and while it unpacks and loads."""
    for pause in (0.0, 0.3, 0.8):
        job = stack.submitted(tiny_archive, LONG_OPTIONS)
        time.sleep(pause)
        stack.http.delete(f"/jobs/{job}")
        stack.wait_for(job, "cancelled", seconds=5)
    time.sleep(0.3)
    assert not stack.job_processes()


@pytest.mark.slow
def test_while_it_extracts_the_surface(stack: Stack, tiny_archive: bytes) -> None:
    """Check that a job is killed at once outside training, where there is nothing to keep."""
    job = stack.submitted(tiny_archive, TINY_OPTIONS)
    stack.wait_for(job, "running", step="mesh")
    stack.http.delete(f"/jobs/{job}")
    stack.wait_for(job, "cancelled", seconds=5)
    assert not stack.job_processes()
    assert stack.http.get(f"/jobs/{job}/mesh.ply").json()["code"] == "no_results"


@pytest.mark.slow
def test_retry_goes_on_from_the_checkpoint(stack: Stack, tiny_archive: bytes) -> None:
    options = LONG_OPTIONS | {"settings": TINY | {"train.warmup.surfel_iterations": 1500}}
    job = stack.submitted(tiny_archive, options)
    while (iteration := stack.wait_for(job, "running", step="train")["iteration"] or 0) < 300:
        time.sleep(0.1)
    stack.http.delete(f"/jobs/{job}")
    stopped = stack.wait_for(job, "cancelled", seconds=STOPPED)
    answer = stack.http.post(f"/jobs/{job}/retry")
    assert answer.status_code == 202 and answer.json()["status"] in ("queued", "running")
    assert stack.http.post(f"/jobs/{job}/retry").json()["code"] == "not_retryable"  # it runs already
    seen: list[int] = []
    while not seen:
        seen = [row["iteration"] for row in stack.wait_for(job, "running", step="train")["curve"][-1:]]
    done = stack.wait_for(job, "succeeded")
    assert done["round"] == 1 and done["attempt"] == 2
    rows = [row["iteration"] for row in done["curve"] if row["stage"] == done["curve"][0]["stage"]]
    assert rows == sorted(rows) and len(stopped["curve"]) <= len(done["curve"])  # one curve, no step back
    log = stack.http.get(f"/jobs/{job}/log.txt").text
    first = next(line for line in log.splitlines() if " alone " in line or "warmup" in line)
    assert int(first.split("/")[0].split()[-1]) >= iteration, first
