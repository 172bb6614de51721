"""The store as a bucket: results by signed addresses, and a bucket that is away for a while."""

from __future__ import annotations

import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import httpx
import pytest

from service.contract.jobs import Jobs
from service.contract.store import Store
from tests.service.hostile import Gate, RawRequest
from tests.service.stack import LONG_OPTIONS, TINY, TINY_OPTIONS, Stack, free_port
from tests.worker.archives import zip_of

AWAY = 20.0


@pytest.fixture
def bucket() -> Iterator[tuple[dict[str, str], Gate]]:
    """Yield settings of a store in a bucket of a real S3 API (moto's server), and the gate before it."""
    port = free_port()
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    gate = Gate(port)
    try:
        _wait_for(port)
        httpx.put(f"http://127.0.0.1:{port}/mgsr-test").raise_for_status()
        gate.open()
        yield (
            {
                "MGSR_STORE": "s3://mgsr-test/some/prefix",
                "AWS_ENDPOINT": f"http://127.0.0.1:{gate.port}",
                "AWS_REGION": "us-east-1",
                "AWS_ACCESS_KEY_ID": "test",
                "AWS_SECRET_ACCESS_KEY": "test",
                "AWS_ALLOW_HTTP": "true",
            },
            gate,
        )
    finally:
        server.terminate()
        server.wait()


def _wait_for(port: int) -> None:
    for _ in range(200):
        with suppress(OSError), closing(socket.create_connection(("127.0.0.1", port), 1)):
            return
        time.sleep(0.1)
    raise AssertionError("moto's server did not start")


@pytest.mark.slow
def test_results_come_from_the_bucket_itself(
    bucket: tuple[dict[str, str], Gate], tmp_path: Path, tiny_archive: bytes
) -> None:
    with Stack(tmp_path, 1, **bucket[0]) as stack:
        same = {"Idempotency-Key": "once"}
        jobs = {stack.submit(tiny_archive, TINY_OPTIONS, **same).json()["id"] for _ in range(2)}
        (job,) = jobs
        stack.wait_for(job, "succeeded")
        answer = stack.http.get(f"/jobs/{job}/mesh.ply")
        assert answer.status_code == 307
        part = httpx.get(answer.headers["Location"], headers={"Range": "bytes=0-2"})
        assert (part.status_code, part.content) == (206, b"ply")
        direct = f"/jobs/{job}/artifacts/mesh.ply?redirect=false"
        part = stack.http.get(direct, headers={"Range": "bytes=0-2"})
        assert (part.status_code, part.content) == (206, b"ply")
        assert [listed["id"] for listed in stack.http.get("/jobs").json()["jobs"]] == [job]
        assert b"done in" in stack.http.get(f"/jobs/{job}/log.txt").content
        assert not (tmp_path / "store").exists()
        # Where callers can't reach the bucket, the service sends the bytes itself.
        stack.stop("api")
        stack.start("api", MGSR_SIGNED_URLS="no")
        stack.wait_until_ready(1)
        part = stack.http.get(f"/jobs/{job}/mesh.ply", headers={"Range": "bytes=0-2"})
        assert (part.status_code, part.content) == (206, b"ply")


@pytest.mark.slow
def test_a_resumable_upload_lies_in_the_bucket_as_parts(
    bucket: tuple[dict[str, str], Gate], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut the connection once; the bucket keeps what had arrived, copies it for a rerun, and deletes it."""
    for name, value in bucket[0].items():
        monkeypatch.setenv(name, value)
    data = zip_of(("noise.bin", random.Random(1).randbytes(14 << 20)), packed=False)
    jobs = Jobs(Store(bucket[0]["MGSR_STORE"], 5.0))
    with Stack(tmp_path, 0, **bucket[0]) as stack:
        tus = {"Tus-Resumable": "1.0.0"}
        created = stack.http.post("/uploads", headers=tus | {"Upload-Length": str(len(data))})
        address, kind = created.headers["Location"], "Content-Type: application/offset+octet-stream"
        headers = (kind, "Tus-Resumable: 1.0.0", "Upload-Offset: 0", f"Content-Length: {len(data)}")
        with RawRequest(stack.port, *headers, path=address, method="PATCH") as request:
            request.send(data[: 11 << 20])
        offset = 0
        while offset == 0:
            time.sleep(0.1)
            offset = int(stack.http.head(address, headers=tus).headers["Upload-Offset"])
        assert offset == 11 << 20
        rest = tus | {"Upload-Offset": str(offset), "Content-Type": "application/offset+octet-stream"}
        assert stack.http.patch(address, headers=rest, content=data[offset:]).status_code == 204
        first = stack.http.post(f"{address}/job").json()["id"]
        second = stack.http.post(f"/jobs/{first}/rerun").json()["id"]
        stack.http.delete(f"/jobs/{first}")
        assert stack.http.delete(f"/jobs/{first}/data").status_code == 204
        (record,) = [found for job in (first, second) if (found := jobs.record(job)) is not None]
    jobs.archives.download(record.archive, tmp_path / "archive")
    assert (tmp_path / "archive").read_bytes() == data and len(jobs.archives.parts(record.archive)) == 2
    jobs.archives.delete(record.archive)
    assert jobs.store.names("uploads") == []


@pytest.mark.slow
def test_a_bucket_that_is_away_costs_no_job(
    bucket: tuple[dict[str, str], Gate], tmp_path: Path, tiny_archive: bytes
) -> None:
    """Check a bucket that is away while the job trains, writes checkpoints and wants to publish."""
    settings, gate = bucket
    with Stack(tmp_path, 1, MGSR_CHECKPOINT_SECONDS="1", **settings) as stack:
        options = LONG_OPTIONS | {"settings": TINY | {"train.warmup.surfel_iterations": 1000}}
        job = stack.submitted(tiny_archive, options)
        stack.wait_for(job, "running", step="train")
        gate.close()
        closed = time.monotonic()
        answers = [stack.http.get("/readyz"), stack.submit(tiny_archive, TINY_OPTIONS)]
        time.sleep(1)
        answers.append(stack.http.get(f"/jobs/{job}"))
        assert [answer.status_code for answer in answers] == [503, 503, 503]
        assert {answer.json()["code"] for answer in answers} == {"store_unavailable"}
        assert stack.http.get("/healthz").status_code == 200
        time.sleep(max(0.0, AWAY - (time.monotonic() - closed)))
        gate.open()
        done = stack.wait_for(job, "succeeded", seconds=120)
        assert done["attempt"] == 1
        assert stack.http.get(f"/jobs/{job}/mesh.ply").status_code == 307
        assert len(stack.http.get("/jobs").json()["jobs"]) == 1
