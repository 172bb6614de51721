"""Jobs go after the retention, pinned and open ones stay; a key stores no more than its limit."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from program.__main__ import app
from service.contract.jobs import Jobs, attempt_path
from service.contract.live import Live
from service.contract.records import JobStatus, Outcome, now
from service.contract.retention import Retention
from service.contract.store import Store
from tests.service.stack import TINY_OPTIONS, Stack
from tests.worker.archives import zip_of

HOUR = 3600.0
ARCHIVE = zip_of(("a.bin", bytes(20_000)), packed=False)


@pytest.fixture(scope="module")
def keeping(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service without workers that keeps jobs for an hour, and 100 KiB of each key."""
    folder = tmp_path_factory.mktemp("keeping")
    with Stack(folder, workers=0, MGSR_RETENTION=str(HOUR), MGSR_MAX_STORED="100KiB") as running:
        yield running


@pytest.fixture
def jobs(keeping: Stack) -> Iterator[Jobs]:
    """Yield the store's jobs; they are removed afterwards."""
    found = Jobs(Store(str(keeping.folder / "store"), 1.0))
    yield found
    for listed in keeping.http.get("/jobs").json()["jobs"]:
        record = found.record(listed["id"])
        assert record is not None
        found.store.delete_all("open")
        found.remove(record)


def ended(stack: Stack, jobs: Jobs, hours: float) -> str:
    """Submit a job, and end it as if that was so many hours ago."""
    job = stack.submitted(ARCHIVE, TINY_OPTIONS)
    finished = now() - timedelta(hours=hours)
    record = jobs.record(job)
    assert record is not None
    earlier = record.model_copy(update={"created": finished - timedelta(hours=1)})
    jobs.store.replace(f"jobs/{job}/job.json", earlier.to_bytes())
    jobs.store.delete_all(f"owners/{record.owner}")
    jobs.finish(job, 0, Outcome(status=JobStatus.SUCCEEDED, attempt=None, finished=finished))
    for listed in jobs.store.names("jobs"):
        if listed.endswith("job.json") and (each := jobs.record(listed.split("/")[0])) is not None:
            jobs.index(each)
    stack.wait_for(job, "succeeded")  # until the service looks at the store again
    return job


def test_only_what_has_ended_long_ago_and_is_not_pinned_goes(
    keeping: Stack, jobs: Jobs, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, pinned, young = (ended(keeping, jobs, hours) for hours in (1.5, 1.5, 0.5))
    running = keeping.submitted(ARCHIVE, TINY_OPTIONS)
    shown = keeping.http.put(f"/jobs/{pinned}/pin").json()
    assert shown["pinned"] and shown["expires"] is None
    goes = keeping.job(young)["expires"]
    left = datetime.fromisoformat(goes) - now()
    assert timedelta(minutes=25) < left < timedelta(minutes=35)
    assert keeping.job(running)["expires"] is None
    monkeypatch.setenv("MGSR_STORE", str(keeping.folder / "store"))
    listed = CliRunner().invoke(app, ["retention", "--days", str(1 / 24)])
    assert listed.exit_code == 0 and listed.stdout.split()[0] == old and listed.stdout.count("\n") == 1
    assert keeping.job(old)["status"] == "succeeded", "a dry run removes nothing"
    Retention(jobs, HOUR).remove_due(Live(keeping.redis))
    assert jobs.record(old) is None and jobs.record(young) is not None and jobs.record(running) is not None
    assert not [path for path in (keeping.folder / "store").rglob("*") if old in path.name]
    assert not keeping.http.delete(f"/jobs/{pinned}/pin").json()["pinned"]
    Retention(jobs, HOUR).remove_due(Live(keeping.redis))
    assert jobs.record(pinned) is None


def test_the_commands_list_and_pin(keeping: Stack, jobs: Jobs) -> None:
    job = ended(keeping, jobs, 0.1)
    for arguments, said in ((["jobs"], "expires "), (["pin", job], "pinned"), (["pin", job, "--off"], "expires ")):
        ran = CliRunner().invoke(app, [*arguments, "--server", keeping.url])
        assert ran.exit_code == 0 and job in ran.stdout and said in ran.stdout, ran.output


def test_without_a_retention_jobs_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("MGSR_RETENTION", raising=False)
    monkeypatch.setenv("MGSR_STORE", str(tmp_path))
    refused = CliRunner().invoke(app, ["retention"])
    assert refused.exit_code == 2 and "MGSR_RETENTION is not set" in refused.output


def test_a_key_stores_no_more_than_its_limit(keeping: Stack, jobs: Jobs) -> None:
    """Check that archives, results and unfinished uploads count, and that the refusal says how much."""
    job = keeping.submitted(ARCHIVE, TINY_OPTIONS)
    jobs.store.replace(attempt_path(job, 1, "mesh.ply"), bytes(30_000))
    address = keeping.http.post("/uploads", headers={"Tus-Resumable": "1.0.0", "Upload-Length": "25000"}).headers[
        "Location"
    ]
    for refused in (
        keeping.submit(ARCHIVE + bytes(10_000), TINY_OPTIONS),
        keeping.http.post("/uploads", headers={"Tus-Resumable": "1.0.0", "Upload-Length": "30000"}),
    ):
        assert (refused.status_code, refused.json()["code"]) == (413, "storage_full")
        assert "adds 30" in refused.json()["detail"] and str(100 << 10) in refused.json()["detail"]
    assert keeping.http.delete(address, headers={"Tus-Resumable": "1.0.0"}).status_code == 204
    assert [keeping.http.post(f"/jobs/{job}/rerun").status_code for _ in range(3)] == [202, 202, 413]
