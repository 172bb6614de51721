"""A job that is run again with other options, from the archive that is in the store."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import httpx
import pytest

from service.client.api import Client
from service.client.submit import fetch_job
from service.contract.jobs import TAKEN_OVER, Jobs, attempt_path
from service.contract.store import Store
from tests.page.puppet import Puppet
from tests.service.stack import Stack
from tests.worker.archives import zip_of
from worker.attempt import Attempt
from worker.lease import LeaseKeeper

ARCHIVE = zip_of(("image.png", b"x"))
OPTIONS: dict[str, Any] = {
    "preset": "draft",
    "name": "vase",
    "settings": {"data.object": "auto", "mesh.poisson_depth": 6},
}
FOUND = {"object.json": b"{}", "masks/r_0.png": b"mask", "cameras/sparse/0/images.bin": b"cameras", "mesh.ply": b"mesh"}


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service without workers."""
    with Stack(tmp_path_factory.mktemp("rerun"), workers=0) as running:
        yield running


@pytest.fixture
def store(idle: Stack) -> Store:
    return Store(str(idle.folder / "store"), 5.0)


def rerun(stack: Stack, job: str, changes: dict[str, Any] | None = None, **headers: str) -> httpx.Response:
    query = {} if changes is None else {"options": json.dumps(changes)}
    return stack.http.post(f"/jobs/{job}/rerun", params=query, headers=headers)


def archive_of(store: Store, job: str) -> bytes | None:
    record = Jobs(store).record(job)
    assert record is not None
    return store.read(record.archive)


def taken_over(store: Store, job: str) -> set[str]:
    return set(store.names(attempt_path(job, TAKEN_OVER, "")))


def test_a_job_is_run_again_with_other_options(idle: Stack, store: Store) -> None:
    first = idle.submitted(ARCHIVE, OPTIONS)
    answer = rerun(idle, first, {"preset": "standard"})
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert job["id"] != first and job["rerun_of"] == first and job["status"] == "queued"
    assert answer.headers["Location"] == f"/jobs/{job['id']}"
    expected = OPTIONS | {"preset": "standard"}
    assert {name: job["options"][name] for name in expected} == expected
    assert idle.http.delete(f"/jobs/{first}").status_code == 200
    assert idle.http.delete(f"/jobs/{first}/data").status_code == 204
    assert archive_of(store, job["id"]) == ARCHIVE, "its archive does not go with the earlier job"


def test_an_archive_that_is_gone(idle: Stack, store: Store) -> None:
    first = idle.submitted(ARCHIVE, OPTIONS)
    record = Jobs(store).record(first)
    assert record is not None
    store.delete(record.archive)
    before = set(store.names("uploads"))
    answer = rerun(idle, first)
    assert answer.status_code == 410 and answer.json()["code"] == "archive_gone"
    assert set(store.names("uploads")) == before


def test_the_same_idempotency_key_gives_one_job(idle: Stack, store: Store) -> None:
    first, key = idle.submitted(ARCHIVE, OPTIONS), {"Idempotency-Key": "again"}
    made = rerun(idle, first, {"seed": 1}, **key)
    before = set(store.names("uploads"))
    same, other = rerun(idle, first, {"seed": 1}, **key), rerun(idle, first, {"seed": 2}, **key)
    assert same.json()["id"] == made.json()["id"] and same.headers["Idempotency-Replayed"] == "true"
    assert other.status_code == 422 and other.json()["code"] == "idempotency_conflict"
    assert set(store.names("uploads")) == before


@pytest.mark.parametrize("changes", [{"preset": "best"}, {"settings": {"max_sid": 3}}, {"archive": "x"}])
def test_options_that_do_not_fit(idle: Stack, changes: dict[str, Any]) -> None:
    answer = rerun(idle, idle.submitted(ARCHIVE, OPTIONS), changes)
    assert answer.status_code == 422 and answer.json()["code"] == "bad_options"


def test_an_unknown_job(idle: Stack) -> None:
    assert rerun(idle, "0" * 32).json()["code"] == "job_unknown"


@pytest.mark.parametrize(
    ("settings", "results"),
    [
        (OPTIONS["settings"] | {"mesh.poisson_depth": 7}, set(FOUND) - {"mesh.ply"}),
        (OPTIONS["settings"] | {"data.max_side": 800}, {"cameras/sparse/0/images.bin"}),
        (OPTIONS["settings"] | {"data.object_box": "-1,-1,0,1,1,2"}, {"cameras/sparse/0/images.bin"}),
        (OPTIONS["settings"] | {"time_budget": 60.0}, {"cameras/sparse/0/images.bin"}),
    ],
)
def test_found_cameras_and_masks_are_taken_over(
    idle: Stack, store: Store, tmp_path: Path, settings: dict[str, Any], results: set[str]
) -> None:
    first = idle.submitted(ARCHIVE, OPTIONS)
    Puppet(idle, first).succeed(FOUND, {})
    job = rerun(idle, first, {"preset": "standard", "settings": settings}).json()["id"]
    assert taken_over(store, job) == results
    record = Jobs(store).record(job)
    assert record is not None
    context = cast(Any, SimpleNamespace(retrying_jobs=Jobs(store)))
    attempt = Attempt(context, record, 0, 1, cast(LeaseKeeper, None))
    attempt._scratch = tmp_path
    attempt._fetch()
    out = tmp_path / "out"
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == results
    assert (tmp_path / "archive").read_bytes() == ARCHIVE


def test_the_client_runs_a_job_again(idle: Stack) -> None:
    first = idle.submitted(ARCHIVE, OPTIONS)
    with Client(idle.url, None) as client:
        job = client.rerun(first, {"seed": 7})
    assert job["options"]["seed"] == 7 and job["options"]["name"] == "vase" and job["rerun_of"] == first


def test_a_dry_run_is_followed_by_a_run(idle: Stack) -> None:
    files = {"archive": ("scene.zip", ARCHIVE, "application/zip")}
    first = idle.http.post("/jobs", params={"dry_run": "true"}, files=files).json()
    assert first["options"]["dry_run"] is True
    assert rerun(idle, first["id"], {"preset": "draft"}).json()["options"]["dry_run"] is False
    assert rerun(idle, first["id"], {"dry_run": True}).json()["options"]["dry_run"] is True


def test_the_command_tells_findings_and_estimate(
    idle: Stack, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    job = idle.submitted(ARCHIVE, OPTIONS | {"dry_run": True})
    finding = {"code": "blurred", "severity": "warning", "text": "2 are blurred", "amount": 2, "unit": "times"}
    puppet = Puppet(idle, job)
    puppet.check([finding | {"cure": "take them again", "photographs": ["a", "b"], "places": []}])
    puppet.succeed({"estimate.json": b"{}"}, {"estimate": [{"preset": "draft", "seconds": 40, "memory_mib": 2048}]})
    assert fetch_job(idle.url, None, job, tmp_path) == 0
    said = capsys.readouterr().out
    assert "warning: 2 are blurred (a, b); take them again" in said and "up to about 40 s and 2.0 GiB" in said
