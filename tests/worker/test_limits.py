"""What ends an attempt from outside: memory, disk, deadline, signals. Each has its clear code."""

from __future__ import annotations

import errno
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.contract.options import JobOptions
from service.contract.store import Store
from service.keys import Keys
from tests.service.stack import LONG_OPTIONS, TINY_OPTIONS, Stack
from worker import job as job_module
from worker.job import JobSpec


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service without workers: each test starts its own."""
    with Stack(tmp_path_factory.mktemp("limited"), workers=0) as running:
        running.worker_names.append("worker0")
        yield running


@pytest.fixture(autouse=True)
def worker_ends(limited: Stack) -> Iterator[None]:
    """Check that no worker, and nothing of one, outlives its test."""
    yield
    if "worker0" in limited.processes:
        limited.stop("worker0")
    assert not limited.job_processes()
    assert not list((limited.folder / "scratch").glob("*"))


def failure(stack: Stack, job: str) -> dict[str, Any]:
    found: dict[str, Any] = stack.wait_for(job, "failed")["error"]
    return found


def test_too_much_memory(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS)
    limited.start("worker0", MGSR_JOB_MEMORY="200MiB")
    error = failure(limited, job)
    assert error["code"] == "out_of_memory" and error["retryable"]
    assert error["peak_memory_bytes"] > 200 << 20 and "200 MiB" in error["message"]


def test_a_full_disk(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS)
    limited.start("worker0", MGSR_MIN_FREE_DISK="1000TiB")
    error = failure(limited, job)
    assert error["code"] == "disk_full" and error["retryable"] and "must stay free" in error["message"]


def test_a_submit_to_a_full_disk(tmp_path: Path, tiny_archive: bytes) -> None:
    with Stack(tmp_path, workers=0, MGSR_MIN_FREE_DISK="1000TiB") as full:
        answer = full.submit(tiny_archive, TINY_OPTIONS)
        assert answer.status_code == 507 and answer.json()["code"] == "disk_full"
        assert not [path for path in (tmp_path / "store").rglob("*") if path.is_file()]


@pytest.mark.slow
def test_too_many_jobs(tmp_path: Path, tiny_archive: bytes) -> None:
    """Check the limit of open jobs for each key: another key's jobs have room, and a job that ended makes room."""
    keys = Keys(Store(str(tmp_path / "store"), 1.0))
    anna, bert = ({"Authorization": f"Bearer {keys.create(name)[0]}"} for name in ("anna", "bert"))
    with Stack(tmp_path, workers=0, MGSR_MAX_OPEN_JOBS="2") as small:
        answers = [small.submit(tiny_archive, TINY_OPTIONS, **anna) for _ in range(3)]
        assert [answer.status_code for answer in answers] == [202, 202, 429]
        assert answers[2].json()["code"] == "queue_full" and int(answers[2].headers["Retry-After"]) > 0
        assert small.submit(tiny_archive, TINY_OPTIONS, **bert).status_code == 202
        assert small.http.delete(f"/jobs/{answers[0].json()['id']}", headers=anna).status_code == 200
        assert small.submit(tiny_archive, TINY_OPTIONS, **anna).status_code == 202


@pytest.mark.slow
def test_a_deadline(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS | {"deadline_seconds": 3})
    limited.start("worker0")
    limited.wait_for(job, "running")
    started_at = time.monotonic()
    error = failure(limited, job)
    assert error["code"] == "deadline_exceeded" and error["retryable"] and "3 s" in error["message"]
    assert time.monotonic() - started_at < 8


@pytest.mark.slow
def test_a_process_that_a_stranger_kills_is_started_again(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS)
    limited.start("worker0")
    limited.wait_for(job, "running", step="train")
    os.kill(limited.job_processes()[0], signal.SIGKILL)
    started_at = time.monotonic()
    while limited.wait_for(job, "running", "queued")["attempt"] != 2:
        time.sleep(0.1)
    assert time.monotonic() - started_at < 30
    limited.wait_for(job, "running", step="train")
    limited.http.delete(f"/jobs/{job}")
    limited.wait_for(job, "cancelled")


@pytest.mark.slow
def test_a_process_that_crashes_says_so(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS)
    limited.start("worker0")
    limited.wait_for(job, "running", step="train")
    os.kill(limited.job_processes()[0], signal.SIGSEGV)
    error = failure(limited, job)
    assert error["code"] == "crashed" and "-11" in error["message"]


@pytest.mark.slow
def test_a_job_whose_workers_die_again_and_again_is_given_up(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS)
    limited.start("worker0", MGSR_MAX_ATTEMPTS="2")
    for attempt in (1, 2):
        while limited.wait_for(job, "running", "queued")["attempt"] != attempt or not limited.job_processes():
            time.sleep(0.1)
        time.sleep(0.5)
        os.kill(limited.job_processes()[0], signal.SIGKILL)
    error = failure(limited, job)
    assert error["code"] == "worker_lost" and error["retryable"]


@pytest.mark.slow
def test_the_job_process_has_no_secrets(limited: Stack, tiny_archive: bytes) -> None:
    job = limited.submitted(tiny_archive, LONG_OPTIONS)
    limited.start("worker0", AWS_SECRET_ACCESS_KEY="very secret")
    limited.wait_for(job, "running", step="train")
    folder = Path(f"/proc/{limited.job_processes()[0]}")
    environment, command = (folder / "environ").read_bytes(), (folder / "cmdline").read_bytes()
    assert b"very secret" not in environment and b"REDIS" not in environment
    assert limited.server.url.encode() not in environment + command
    limited.http.delete(f"/jobs/{job}")
    limited.wait_for(job, "cancelled")


@pytest.mark.parametrize(
    ("trouble", "code"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "disk_full"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "disk_full"),
        (MemoryError(), "out_of_memory"),
        (OSError(errno.EIO, "Input/output error"), "internal"),
        (ZeroDivisionError("division by zero"), "internal"),
    ],
)
def test_what_the_process_itself_meets(
    trouble: BaseException, code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(spec: JobSpec) -> None:
        raise trouble

    monkeypatch.setattr(job_module, "_reconstruct", fail)
    folders = {name: tmp_path / name for name in ("archive", "scene", "out", "previews", "result")}
    limits = {"max_members": 1, "max_unpacked": 1, "max_ratio": 1.0, "max_pixels": 1}
    values: dict[str, Any] = folders | limits
    spec = JobSpec(options=JobOptions(), resume=False, checkpoint_seconds=1.0, **values)
    result = job_module._run(spec)
    assert (result.status, result.code) == ("failed", code) and result.message
