"""Jobs are removed only when their owner asks, and then completely."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.service.stack import TINY_OPTIONS, Stack
from tests.worker.archives import zip_of


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service without workers."""
    with Stack(tmp_path_factory.mktemp("idle"), workers=0) as running:
        yield running


def files_of(stack: Stack, job: str) -> list[Path]:
    """Return everything in the store that has the job's id in its path."""
    return [path for path in (stack.folder / "store").rglob("*") if path.is_file() and job in str(path)]


def test_a_job_that_has_ended_is_removed_whole(idle: Stack, tiny_archive: bytes) -> None:
    """Check that the idempotency key goes too, so that the same submit is a new job."""
    key = {"Idempotency-Key": "once"}
    job = idle.submit(tiny_archive, TINY_OPTIONS, **key).json()["id"]
    other = idle.submitted(tiny_archive, TINY_OPTIONS)
    refused = idle.http.delete(f"/jobs/{job}/data")
    assert refused.status_code == 409 and refused.json()["code"] == "job_open"
    assert idle.http.delete(f"/jobs/{job}").status_code == 200 and files_of(idle, job)
    assert idle.http.delete(f"/jobs/{job}/data").status_code == 204
    assert idle.http.get(f"/jobs/{job}").status_code == 404 and not files_of(idle, job)
    assert idle.http.delete(f"/jobs/{job}/data").status_code == 404
    assert [found["id"] for found in idle.http.get("/jobs").json()["jobs"]] == [other]
    anew = idle.submit(tiny_archive, TINY_OPTIONS, **key)
    assert anew.json()["status"] == "queued" and "Idempotency-Replayed" not in anew.headers


@pytest.mark.slow
def test_results_go_too(stack: Stack, tiny_archive: bytes) -> None:
    job = stack.submitted(tiny_archive, TINY_OPTIONS)
    ended: dict[str, Any] = stack.wait_for(job, "succeeded")
    assert ended["metrics"] and len(files_of(stack, job)) > 5
    assert stack.http.delete(f"/jobs/{job}/data").status_code == 204
    assert stack.http.get(f"/jobs/{job}/mesh.ply").status_code == 404 and not files_of(stack, job)


def test_a_refused_archive_does_not_hinder(stack: Stack) -> None:
    """Check that a job is removed whose archive the worker has removed already."""
    job = stack.submitted(zip_of(("readme.txt", b"nothing")), TINY_OPTIONS)
    stack.wait_for(job, "failed")
    assert stack.http.delete(f"/jobs/{job}/data").status_code == 204 and not files_of(stack, job)
