"""Uploads that are too large, too slow, cut or malformed: the right problem, nothing left behind, memory bounded."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from service.contract.archives import STALE_SECONDS
from service.contract.jobs import Jobs
from service.contract.store import Store
from tests.service.hostile import RawRequest
from tests.service.stack import TINY_OPTIONS, Stack
from tests.worker.archives import MALICIOUS, zip_of

LIMITS = {
    "MGSR_MAX_UPLOAD": "30MiB",
    "MGSR_UPLOAD_IDLE": "1.5",
    "MGSR_UPLOAD_GRACE": "1",
    "MGSR_UPLOAD_RATE": "100KiB",
    "MGSR_MAX_MEMBERS": "50",
    "MGSR_MAX_UNPACKED": "100MiB",
    "MGSR_MAX_PIXELS": "1000000",
}
ZIP = "Content-Type: application/zip"


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service with small limits."""
    with Stack(tmp_path_factory.mktemp("strict"), 1, **LIMITS) as running:
        yield running


@pytest.fixture(autouse=True)
def nothing_left_behind(strict: Stack) -> Iterator[None]:
    """Check after each test that the store, and the file system, hold only uploads that jobs name."""
    yield
    time.sleep(0.3)
    left = {path for path in (strict.folder / "store/uploads").rglob("*") if path.is_file()}
    kept = {path for path in left if (strict.folder / "store/jobs" / path.name.split(".")[0] / "job.json").exists()}
    assert left == kept and not any("#" in path.name for path in left)


def memory_peak(stack: Stack) -> int:
    """Return the peak memory of the API, bytes."""
    status = Path(f"/proc/{stack.processes['api'].pid}/status").read_text()
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))) * 1024


def test_five_gigabytes_are_refused_by_their_claim(strict: Stack) -> None:
    with RawRequest(strict.port, ZIP, f"Content-Length: {5 << 30}") as request:
        found = request.answer()
    assert (found.status, found.body["code"]) == (413, "archive_too_large")


def test_bytes_are_counted_when_nothing_is_claimed(strict: Stack) -> None:
    """Check a chunked transfer of 200 MB; what comes after the refusal is thrown away."""
    before = memory_peak(strict)
    chunk = b"100000\r\n" + b"PK\x03\x04" + bytes((1 << 20) - 4) + b"\r\n"
    with RawRequest(strict.port, ZIP, "Transfer-Encoding: chunked") as request:
        for _ in range(200):
            request.send(chunk)
        found = request.answer()
    assert (found.status, found.body["code"]) == (413, "archive_too_large")
    assert memory_peak(strict) - before < 64 << 20


def test_the_refusal_reaches_a_client_that_sends_on(strict: Stack) -> None:
    answer = strict.http.post(
        "/jobs", content=b"PK\x03\x04" + bytes(60 << 20), headers={"Content-Type": "application/zip"}
    )
    assert answer.status_code == 413 and answer.json()["code"] == "archive_too_large"


@pytest.mark.slow
def test_a_large_upload_needs_little_memory(strict: Stack) -> None:
    before = memory_peak(strict)
    data = zip_of(("a.bin", bytes(28 << 20)), packed=False)
    for _ in range(3):
        job = strict.submitted(data, TINY_OPTIONS)
        strict.http.delete(f"/jobs/{job}")
    assert memory_peak(strict) - before < 40 << 20


def test_silence_is_given_up(strict: Stack) -> None:
    started_at = time.monotonic()
    with RawRequest(strict.port, ZIP, "Content-Length: 1000000") as request:
        request.send(b"PK\x03\x04" + bytes(1000))
        found = request.answer()
    assert (found.status, found.body["code"]) == (408, "upload_too_slow")
    assert time.monotonic() - started_at < 5


def test_a_trickle_is_given_up(strict: Stack) -> None:
    with RawRequest(strict.port, ZIP, "Content-Length: 1000000") as request:
        request.trickle(20, 0.2)
        found = request.answer()
    assert found.status in (408, 0)


def test_a_cut_upload_leaves_nothing(strict: Stack, tiny_archive: bytes) -> None:
    jobs = len(strict.http.get("/jobs").json()["jobs"])
    for kind in (ZIP, "Content-Type: multipart/form-data; boundary=xyz"):
        with RawRequest(strict.port, kind, "Content-Length: 20000000") as request:
            if "multipart" in kind:
                request.send(b'--xyz\r\nContent-Disposition: form-data; name="archive"; filename="a.zip"\r\n\r\n')
            request.send(b"PK\x03\x04" + bytes(12 << 20))  # several parts of the store
            time.sleep(0.3)
    time.sleep(0.5)
    assert len(strict.http.get("/jobs").json()["jobs"]) == jobs


MULTIPART = "multipart/form-data; boundary=xyz"
ARCHIVE_PART = b'--xyz\r\nContent-Disposition: form-data; name="archive"; filename="a.zip"\r\n\r\nPK\x03\x04abc\r\n'


def options_part(text: bytes) -> bytes:
    return b'--xyz\r\nContent-Disposition: form-data; name="options"\r\n\r\n' + text + b"\r\n"


@pytest.mark.parametrize(
    ("kind", "body", "status", "code"),
    [
        ("text/plain", b"hello", 415, "content_type_unsupported"),
        ("application/zip", b"", 422, "archive_missing"),
        ("application/zip", b"hello, this is no archive at all", 422, "archive_unsupported"),
        ("multipart/form-data", b"--xyz--", 400, "multipart_malformed"),
        (MULTIPART, b"no boundary here", 400, "multipart_malformed"),
        (MULTIPART, ARCHIVE_PART, 400, "multipart_malformed"),
        (MULTIPART, options_part(b"{}") + b"--xyz--\r\n", 422, "archive_missing"),
        (MULTIPART, ARCHIVE_PART + ARCHIVE_PART + b"--xyz--\r\n", 400, "multipart_malformed"),
        (MULTIPART, ARCHIVE_PART.replace(b'"archive"', b'"other"') + b"--xyz--\r\n", 422, "field_unknown"),
        (MULTIPART, ARCHIVE_PART + options_part(b"{") + b"--xyz--\r\n", 422, "bad_options"),
        (MULTIPART, ARCHIVE_PART + options_part(b"\xff") + b"--xyz--\r\n", 422, "bad_options"),
        (MULTIPART, ARCHIVE_PART + options_part(b"x" * 300_000) + b"--xyz--\r\n", 413, "options_too_large"),
        (MULTIPART, ARCHIVE_PART + options_part(b'{"preset": "best"}') + b"--xyz--\r\n", 422, "bad_options"),
        (MULTIPART, ARCHIVE_PART + options_part(b'{"colour": 1}') + b"--xyz--\r\n", 422, "bad_options"),
        (
            MULTIPART,
            ARCHIVE_PART + options_part(b'{"settings": {"data.object_box": "1,2"}}') + b"--xyz--\r\n",
            422,
            "bad_options",
        ),
    ],
)
def test_what_is_malformed_is_refused(strict: Stack, kind: str, body: bytes, status: int, code: str) -> None:
    answer = strict.http.post("/jobs", content=body, headers={"Content-Type": kind})
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"max_sied": 5}, "data.max_side"),
        ({"data.max_side": "large"}, "integer"),
        ({"data.max_side": -1}, "at least 0"),
        ({"data.masks": "maybe"}, "auto, object, ignore, off"),
        ({"every": 3}, "ambiguous"),
        ({"train.volumes.max_start": 9}, "use 'train.gaussians.max_start'"),
        ({"train.paper.tv": 1}, "true or false"),
    ],
)
def test_a_wrong_setting_is_named_with_the_cure(strict: Stack, settings: dict[str, object], said: str) -> None:
    answer = strict.submit(b"PK\x03\x04", {"settings": settings})
    assert answer.status_code == 422 and answer.json()["code"] == "bad_options"
    assert said in answer.json()["detail"]


@pytest.mark.slow
def test_the_archive_as_the_body(strict: Stack) -> None:
    """Check options in the query; the worker refuses the archive, so it went the whole way."""
    answer = strict.http.post(
        "/jobs",
        params={"options": '{"preset": "draft"}'},
        content=zip_of(("readme.txt", b"nothing")),
        headers={"Content-Type": "application/zip"},
    )
    assert answer.status_code == 202 and answer.json()["options"]["preset"] == "draft"
    assert strict.wait_for(answer.json()["id"], "failed")["error"]["code"] == "bad_scene"


def test_a_malicious_archive_fails_by_its_code(strict: Stack) -> None:
    check_refused(strict, "zip_parent")


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(MALICIOUS))
def test_every_malicious_archive_fails_by_its_code(strict: Stack, name: str) -> None:
    check_refused(strict, name)


def check_refused(strict: Stack, name: str) -> None:
    make, code = MALICIOUS[name]
    answer = strict.submit(make(), TINY_OPTIONS)
    assert answer.status_code == 202, answer.text
    failed = strict.wait_for(answer.json()["id"], "failed")
    assert failed["error"]["code"] == code and not failed["error"]["retryable"]
    assert str(strict.folder) not in failed["error"]["message"]
    assert strict.http.post(f"/jobs/{failed['id']}/retry").json()["code"] == "not_retryable"
    assert not [path for path in (strict.folder / "scratch").iterdir() if failed["id"] in path.name]


def test_two_submits_at_the_same_moment_are_one_job(strict: Stack, tiny_archive: bytes) -> None:
    def send(number: int) -> httpx.Response:
        return httpx.post(
            f"{strict.url}/jobs",
            content=tiny_archive,
            headers={"Content-Type": "application/zip", "Idempotency-Key": "one and the same"},
            params={"options": '{"preset": "draft", "deadline_seconds": 1}'},
            timeout=60,
        )

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(send, range(8)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert sum("Idempotency-Replayed" in answer.headers for answer in answers) == 7
    other = strict.submit(tiny_archive, {"preset": "high"}, **{"Idempotency-Key": "one and the same"})
    assert other.status_code == 422 and other.json()["code"] == "idempotency_conflict"
    job = answers[0].json()["id"]
    strict.finished(job)
    assert len(list((strict.folder / f"store/jobs/{job}/attempts").iterdir())) == 1


def test_what_a_killed_service_was_receiving_is_swept(tmp_path: Path) -> None:
    """Check that only stale uploads are swept, after hours: another service may be receiving a newer one."""
    with Stack(tmp_path, workers=0) as stack:
        kept = stack.submitted(zip_of(("a.bin", b"kept")), TINY_OPTIONS)
        with RawRequest(stack.port, ZIP, "Content-Length: 20000000") as request:
            request.send(b"PK\x03\x04" + bytes(12 << 20))
            time.sleep(0.5)
            stack.kill("api")
    (tmp_path / "store/uploads" / f"{'0' * 32}.{'1' * 32}").write_bytes(b"whole, but of no job")
    uploads = tmp_path / "store/uploads"
    assert len(list(uploads.iterdir())) == 3
    jobs = Jobs(Store(str(tmp_path / "store"), 1.0))
    jobs.sweep_uploads()
    assert len(list(uploads.iterdir())) == 3
    for path in uploads.iterdir():
        os.utime(path, (time.time() - 2 * STALE_SECONDS,) * 2)
    jobs.sweep_uploads()
    assert [path.name.split(".")[0] for path in uploads.iterdir()] == [kept]
