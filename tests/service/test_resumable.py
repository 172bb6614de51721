"""Uploads in several requests by the tus protocol: cut connections, refusals, expiry, other clients of the protocol."""

from __future__ import annotations

import base64
import hashlib
import io
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from tusclient import client as tuspy
from tusclient.exceptions import TusCommunicationError

from service.client import Client, ServiceRefusal
from service.client.api import Progress
from service.client.submit import submit_scene
from service.client.unfinished import default_folder
from service.contract.archives import Archives
from service.contract.jobs import Jobs
from service.contract.options import JobOptions
from service.contract.resumable import ResumableUploads, job_of
from service.contract.store import Store
from service.keys import Keys
from tests.service.hostile import Gate, RawRequest
from tests.service.stack import TINY_OPTIONS, Stack
from tests.worker.archives import zip_of

TUS = {"Tus-Resumable": "1.0.0"}
BYTES = TUS | {"Content-Type": "application/offset+octet-stream"}


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Yield a service without workers, which accepts 40 MiB."""
    with Stack(tmp_path_factory.mktemp("idle"), workers=0, MGSR_MAX_UPLOAD="40MiB") as running:
        yield running


@pytest.fixture(scope="module")
def archive() -> bytes:
    """Provide a zip of 35 MiB of noise: more than one part of the store."""
    return zip_of(("noise.bin", random.Random(1).randbytes(35 << 20)), packed=False)


def begin(stack: Stack, size: int, **headers: str) -> str:
    """Begin an upload, and return its address."""
    answer = stack.http.post("/uploads", headers=TUS | {"Upload-Length": str(size)} | headers)
    assert answer.status_code == 201, answer.text
    return answer.headers["Location"]


def offset(stack: Stack, address: str) -> int:
    """Return how many bytes have arrived."""
    answer = stack.http.head(address, headers=TUS)
    assert answer.status_code == 200 and answer.headers["Cache-Control"] == "no-store"
    return int(answer.headers["Upload-Offset"])


def settled_offset(stack: Stack, address: str) -> int:
    """Return how many bytes have arrived, once no more of an interrupted request arrive."""
    before, now = -1, offset(stack, address)
    while now != before:
        time.sleep(0.3)
        before, now = now, offset(stack, address)
    return now


def append(stack: Stack, address: str, at: int, data: bytes, **headers: str) -> httpx.Response:
    """Send bytes that begin at a place."""
    return stack.http.patch(address, content=data, headers=BYTES | {"Upload-Offset": str(at)} | headers)


def refused(answer: httpx.Response, status: int, code: str) -> str:
    """Check a refusal, and return its words."""
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.headers["Tus-Resumable"] == "1.0.0"
    return str(answer.json()["detail"])


def stored(stack: Stack, job: str, path: Path) -> bytes:
    """Return a job's archive as its worker would get it."""
    jobs = Jobs(Store(str(stack.folder / "store"), 1.0))
    record = jobs.record(job)
    assert record is not None
    jobs.archives.download(record.archive, path)
    return path.read_bytes()


def test_an_upload_that_is_cut_three_times_arrives_byte_for_byte(idle: Stack, archive: bytes, tmp_path: Path) -> None:
    """Break the connection in the middle of a request, three times; what had arrived is not sent again."""
    address, seen = begin(idle, len(archive)), [0]
    for _ in range(3):
        at = seen[-1]
        headers = [f"{name}: {value}" for name, value in (BYTES | {"Upload-Offset": str(at)}).items()]
        length = f"Content-Length: {len(archive) - at}"
        with RawRequest(idle.port, *headers, length, path=address, method="PATCH") as request:
            request.send(archive[at : at + (9 << 20)])
        ends = time.monotonic() + 20
        while offset(idle, address) == at:
            assert time.monotonic() < ends
            time.sleep(0.05)
        seen.append(offset(idle, address))
    assert seen == [0, 9 << 20, 18 << 20, 27 << 20]
    early = idle.http.post(f"{address}/job")
    assert (early.status_code, early.json()["code"]) == (409, "upload_incomplete")
    answer = append(idle, address, seen[-1], archive[seen[-1] :])
    assert answer.status_code == 204 and int(answer.headers["Upload-Offset"]) == len(archive)
    job = idle.http.post(f"{address}/job", params={"options": '{"preset": "draft"}'}).json()
    assert job["status"] == "queued" and job["options"]["preset"] == "draft"
    assert stored(idle, job["id"], tmp_path / "archive") == archive
    again = idle.http.post(f"{address}/job")
    assert again.json()["id"] == job["id"] and again.headers["Idempotency-Replayed"] == "true"
    refused_head = idle.http.head(address, headers=TUS)
    assert refused_head.status_code == 404, "the job has taken it"


def test_what_the_service_supports(idle: Stack) -> None:
    answer = idle.http.options("/uploads")
    assert answer.status_code == 204 and answer.headers["Tus-Version"] == "1.0.0"
    assert set(answer.headers["Tus-Extension"].split(",")) == {"creation", "termination", "expiration", "checksum"}
    assert int(answer.headers["Tus-Max-Size"]) == 40 << 20


def test_a_wrong_offset_is_told_the_right_one(idle: Stack) -> None:
    address = begin(idle, 1000)
    assert append(idle, address, 0, b"PK\x03\x04" + bytes(96)).status_code == 204
    for wrong in (0, 99, 101):
        answer = append(idle, address, wrong, bytes(10))
        assert "expected 100" in refused(answer, 409, "upload_offset") and answer.headers["Upload-Offset"] == "100"
    assert offset(idle, address) == 100


def test_what_is_too_large_is_refused_at_once(idle: Stack) -> None:
    answer = idle.http.post("/uploads", headers=TUS | {"Upload-Length": str((40 << 20) + 1)})
    assert str(40 << 20) in refused(answer, 413, "archive_too_large")
    address = begin(idle, 100)
    refused(append(idle, address, 0, b"PK" + bytes(99)), 413, "upload_too_long")

    def chunks() -> Iterator[bytes]:
        yield b"PK\x03\x04"
        yield bytes(1000)

    answer = idle.http.patch(address, content=chunks(), headers=BYTES | {"Upload-Offset": "0"})
    refused(answer, 413, "upload_too_long")
    assert offset(idle, address) == 0


def test_unknown_and_malformed_requests_are_refused_in_words(idle: Stack) -> None:
    for unknown in ("0" * 32, "nonsense", "..%2f..%2fkeys"):
        assert idle.http.patch(f"/uploads/{unknown}", headers=BYTES | {"Upload-Offset": "0"}).status_code == 404
    refused(append(idle, f"/uploads/{'0' * 32}", 0, b""), 404, "upload_unknown")
    address = begin(idle, 1000)
    answer = idle.http.patch(address, headers={"Upload-Offset": "0"})
    assert "1.0.0" in refused(answer, 412, "tus_version") and answer.headers["Tus-Version"] == "1.0.0"
    refused(append(idle, address, 0, b"PK", **{"Content-Type": "application/zip"}), 415, "content_type_unsupported")
    refused(append(idle, address, 0, b"neither an archive nor a video" * 40), 413, "upload_too_long")
    refused(append(idle, address, 0, b"neither an archive nor a video" * 20), 422, "archive_unsupported")
    assert offset(idle, address) == 0
    assert idle.http.post("/uploads", headers=TUS).status_code == 422
    assert idle.http.post("/uploads", headers=TUS | {"Upload-Length": "0"}).status_code == 422


def test_options_are_checked_before_anything_is_sent(idle: Stack) -> None:
    for wrong in (b'{"preset": "best"}', b"\xff"):
        metadata = f"filename {base64.b64encode(b'a.zip').decode()},options {base64.b64encode(wrong).decode()}"
        headers = TUS | {"Upload-Length": "100", "Upload-Metadata": metadata}
        refused(idle.http.post("/uploads", headers=headers), 422, "bad_options")
    good = base64.b64encode(b'{"preset": "high", "name": "vase"}').decode()
    address = begin(idle, 100, **{"Upload-Metadata": f"options {good}"})
    assert append(idle, address, 0, b"PK" + bytes(98)).status_code == 204
    job = idle.http.post(f"{address}/job").json()
    assert (job["options"]["preset"], job["name"]) == ("high", "vase")


def test_a_deleted_upload_is_gone_with_its_bytes(idle: Stack) -> None:
    address = begin(idle, 1000)
    before = set((idle.folder / "store/uploads").iterdir())
    append(idle, address, 0, b"PK" + bytes(98))
    assert set((idle.folder / "store/uploads").iterdir()) - before
    assert idle.http.delete(address, headers=TUS).status_code == 204
    refused(idle.http.delete(address, headers=TUS), 404, "upload_unknown")
    assert set((idle.folder / "store/uploads").iterdir()) == before


def test_a_checksum_that_differs_drops_the_bytes(idle: Stack) -> None:
    address, data = begin(idle, 200), b"PK" + bytes(98)
    right = base64.b64encode(hashlib.sha1(data).digest()).decode()
    wrong = base64.b64encode(hashlib.sha1(b"other").digest()).decode()
    refused(append(idle, address, 0, data, **{"Upload-Checksum": f"sha1 {wrong}"}), 460, "checksum_mismatch")
    refused(append(idle, address, 0, data, **{"Upload-Checksum": f"crc32 {right}"}), 400, "checksum_unsupported")
    assert offset(idle, address) == 0
    assert append(idle, address, 0, data, **{"Upload-Checksum": f"sha1 {right}"}).status_code == 204
    assert offset(idle, address) == 100


def test_an_upload_expires(tmp_path: Path) -> None:
    with Stack(tmp_path, workers=0, MGSR_UPLOAD_LIFETIME="3") as stack:
        address = begin(stack, 1000)
        assert append(stack, address, 0, b"PK" + bytes(98)).status_code == 204
        time.sleep(3.2)
        assert "begin a new one" in refused(append(stack, address, 100, bytes(10)), 410, "upload_expired")
        uploads = ResumableUploads(Store(str(tmp_path / "store"), 1.0), 3.0)
        younger = begin(stack, 1000)
        uploads.sweep()
        refused(append(stack, address, 100, bytes(10)), 404, "upload_unknown")
        assert offset(stack, younger) == 0
        assert not [path for path in (tmp_path / "store/uploads").rglob("*") if path.is_file()]


def test_an_upload_belongs_to_its_key_and_counts_for_it(tmp_path: Path) -> None:
    keys = Keys(Store(str(tmp_path / "store"), 1.0))
    (one, _), (other, _) = keys.create("one"), keys.create("other")
    with Stack(tmp_path, workers=0, MGSR_MAX_OPEN_JOBS="2") as stack:
        mine, theirs = ({"Authorization": f"Bearer {token}"} for token in (one, other))
        assert stack.http.post("/uploads", headers=TUS | {"Upload-Length": "9"}).status_code == 401
        address = begin(stack, 100, **mine)
        for method in ("HEAD", "PATCH", "DELETE"):
            headers = BYTES | theirs | {"Upload-Offset": "0"}
            assert stack.http.request(method, address, headers=headers).status_code == 404
        assert stack.http.post(f"{address}/job", headers=theirs).status_code == 404
        begin(stack, 100, **mine)
        answer = stack.http.post("/uploads", headers=TUS | mine | {"Upload-Length": "9"})
        said = refused(answer, 429, "queue_full")
        assert "2 of your jobs" in said and "limit is 2" in said
        begin(stack, 100, **theirs)


def test_the_official_python_client(idle: Stack, archive: bytes, tmp_path: Path) -> None:
    """Witness: the client of the protocol's authors, with checksums, stopped and taken up again."""
    source = tmp_path / "scene.zip"
    source.write_bytes(archive)
    protocol = tuspy.TusClient(f"{idle.url}/uploads")
    first = protocol.uploader(str(source), chunk_size=5 << 20, upload_checksum=True)
    first.upload(stop_at=12 << 20)
    assert 12 << 20 <= first.offset < len(archive)
    second = protocol.uploader(str(source), url=first.url, chunk_size=5 << 20, upload_checksum=True)
    second.upload()
    assert second.offset == len(archive)
    assert first.url is not None
    job = idle.http.post(f"{httpx.URL(first.url).path}/job").json()["id"]
    assert stored(idle, job, tmp_path / "archive") == archive
    with pytest.raises(TusCommunicationError):
        protocol.uploader(file_stream=io.BytesIO(b"no archive" * 100), chunk_size=1000).upload()


def test_our_client_goes_on_over_a_connection_that_breaks_three_times(
    idle: Stack, archive: bytes, tmp_path: Path
) -> None:
    source, gate, breaks, reported = tmp_path / "scene.zip", Gate(idle.port), [30 << 20, 20 << 20, 5 << 20], [0]
    source.write_bytes(archive)

    def progress(done: int, total: int) -> None:
        assert total == len(archive)
        reported.append(done)
        if breaks and done > breaks[-1]:
            breaks.pop()
            gate.close()
            threading.Timer(0.3, gate.open).start()

    gate.open()
    with Client(f"http://127.0.0.1:{gate.port}", None) as client:
        job = client.submit(source, {"preset": "draft", "name": "vase"}, progress)
    gate.close()
    assert not breaks and reported[-1] == len(archive)
    assert (job["name"], job["options"]["preset"]) == ("vase", "draft")
    assert stored(idle, job["id"], tmp_path / "archive") == archive
    again = sum(max(0, later - earlier) for earlier, later in itertools.pairwise(reported)) - len(archive)
    assert again < 30 << 20, "more was sent again than the sockets hold; 55 MiB would be all"


# Submits what `mgsr submit` would, and is killed when 20 MiB have been sent.
KILLED = """
import os, signal, sys
from pathlib import Path
from service.client import Client
from service.client.unfinished import default_folder
from service.contract.options import JobOptions

def sent(done: int, total: int) -> None:
    if done > 20 << 20:
        os.kill(os.getpid(), signal.SIGKILL)

options = JobOptions(name=Path(sys.argv[2]).name).model_dump(mode="json")
with Client(sys.argv[1], None, default_folder()) as client:
    client.submit(Path(sys.argv[2]), options, sent)
"""


def unfinished(stack: Stack, folder: Path) -> str:
    """Return the id of the only upload that a folder of unfinished ones names; the service has a part of it."""
    (note,) = folder.iterdir()
    address = note.read_text()
    ends = time.monotonic() + 20
    while not 10 << 20 < offset(stack, address) < 35 << 20:
        assert time.monotonic() < ends
        time.sleep(0.05)
    return address.rpartition("/")[2]


def test_a_submit_that_was_killed_is_continued_by_the_same_submit(
    idle: Stack, archive: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kill the sending program; `mgsr submit` with the same folder then makes a job of the same upload."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / "noise.jpg").write_bytes(archive)
    program = [sys.executable, "-c", KILLED, idle.url, str(scene)]
    assert subprocess.run(program, env=idle.environment | os.environ, check=False).returncode == -signal.SIGKILL
    upload = unfinished(idle, default_folder())
    assert submit_scene(idle.url, None, scene, JobOptions(name="scene"), None) == 0
    job = idle.http.get(f"/jobs/{job_of('local', upload)}").json()
    assert (job["status"], job["name"]) == ("queued", "scene")
    assert not list(default_folder().iterdir())
    with zipfile.ZipFile(io.BytesIO(stored(idle, job["id"], tmp_path / "archive"))) as sent:
        assert sent.read("noise.jpg") == archive


def interrupted_after(count: int) -> Progress:
    """Return a progress callback that interrupts once more than so many bytes are sent."""

    def interrupt(done: int, total: int) -> None:
        if done > count:
            raise KeyboardInterrupt

    return interrupt


def test_an_interrupted_upload_sends_only_what_is_missing(idle: Stack, archive: bytes, tmp_path: Path) -> None:
    source, folder, reported = tmp_path / "scene.zip", tmp_path / "unfinished", [0]
    source.write_bytes(archive)

    interrupt = interrupted_after(34 << 20)
    with Client(idle.url, None, folder) as client, pytest.raises(KeyboardInterrupt):
        client.submit(source, {"name": "one"}, interrupt)
    upload = unfinished(idle, folder)
    with Client(idle.url, None, folder) as client:
        other = client.submit(source, {"name": "two"})  # other options: an upload of its own
        job = client.submit(source, {"name": "one"}, lambda done, total: reported.append(done))
    assert job["id"] == job_of("local", upload) != other["id"]
    assert reported[1] >= 32 << 20, "the first request was whole, so its bytes are not sent again"
    assert stored(idle, job["id"], tmp_path / "archive") == archive


def test_an_upload_that_the_service_lost_begins_anew(idle: Stack, archive: bytes, tmp_path: Path) -> None:
    source, folder = tmp_path / "scene.zip", tmp_path / "unfinished"
    source.write_bytes(archive)

    interrupt = interrupted_after(20 << 20)
    with Client(idle.url, None, folder) as client:
        with pytest.raises(KeyboardInterrupt):
            client.submit(source, {}, interrupt)
        upload = unfinished(idle, folder)
        assert idle.http.delete(f"/uploads/{upload}", headers=TUS).status_code == 204
        job = client.submit(source, {})
    assert job["id"] != job_of("local", upload)
    assert stored(idle, job["id"], tmp_path / "archive") == archive


def test_a_job_whose_answer_got_lost_is_not_made_twice(idle: Stack, archive: bytes, tmp_path: Path) -> None:
    """Kill the program between the job and its note of it: the same submit finds that job."""
    source, folder = tmp_path / "scene.zip", tmp_path / "unfinished"
    source.write_bytes(archive)

    interrupt = interrupted_after(34 << 20)
    with Client(idle.url, None, folder) as client:
        with pytest.raises(KeyboardInterrupt):
            client.submit(source, {}, interrupt)
        address = f"/uploads/{unfinished(idle, folder)}"
        begun = settled_offset(idle, address)
        assert append(idle, address, begun, archive[begun:]).status_code == 204
        made = idle.http.post(f"{address}/job").json()["id"]
        assert client.submit(source, {})["id"] == made
    assert not list(folder.iterdir())


def test_what_our_client_gives_up_is_deleted(idle: Stack, tmp_path: Path) -> None:
    """Check that a refused archive does not count as an open job until it expires."""
    (tmp_path / "scene.zip").write_bytes(bytes(33 << 20))
    with Client(idle.url) as client, pytest.raises(ServiceRefusal) as refusal:
        client.submit(tmp_path / "scene.zip", {})
    assert refusal.value.code == "archive_unsupported"
    records = [path.read_text() for path in (idle.folder / "store/resumable").rglob("*.json")]
    assert not [record for record in records if str(33 << 20) in record]


def test_parts_are_joined_without_gaps(tmp_path: Path) -> None:
    """Check parts that two connections have written, one of which was cut: the longest from each byte on counts."""
    store = Store(str(tmp_path / "store"), 1.0)
    for name, data in {
        "000000000000000.aa": b"abc",
        "000000000000000.bb": b"abcdef",
        "000000000000003.aa": b"def",
        "000000000000006.aa": b"gh",
        "000000000000009.aa": b"jk",
    }.items():
        store.replace(f"uploads/{'1' * 32}.2/{name}", data)
    archives = Archives(store)
    archives.download(f"uploads/{'1' * 32}.2", tmp_path / "whole")
    assert (tmp_path / "whole").read_bytes() == b"abcdefgh"
    assert archives.copy(f"uploads/{'1' * 32}.2", f"uploads/{'3' * 32}.4")
    archives.delete(f"uploads/{'1' * 32}.2")
    archives.download(f"uploads/{'3' * 32}.4", tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == b"abcdefgh"
    assert not archives.copy(f"uploads/{'1' * 32}.2", f"uploads/{'5' * 32}.6")


def test_an_upload_on_its_way_is_not_swept_as_stale(tmp_path: Path) -> None:
    """Check that a slow upload keeps what arrived hours ago."""
    store = Store(str(tmp_path), 1.0)
    state = ResumableUploads(store, 86400.0).create("local", 100, None)
    for archive in (state.record.archive, f"uploads/{'1' * 32}.{'2' * 32}"):
        store.replace(f"{archive}/000000000000000.aa", b"PK")
    for path in (tmp_path / "uploads").rglob("*"):
        os.utime(path, (time.time() - 12 * 3600,) * 2)
    Jobs(store).sweep_uploads()
    assert [path.name for path in (tmp_path / "uploads").iterdir()] == [state.record.archive.removeprefix("uploads/")]


@pytest.mark.slow
def test_an_archive_in_parts_is_worked_on_and_rerun(stack: Stack, tiny_archive: bytes) -> None:
    address, half = begin(stack, len(tiny_archive)), len(tiny_archive) // 2
    append(stack, address, 0, tiny_archive[:half])
    append(stack, address, half, tiny_archive[half:])
    job = stack.http.post(f"{address}/job", params={"options": json.dumps(TINY_OPTIONS)}).json()["id"]
    assert stack.wait_for(job, "succeeded")["metrics"]
    rerun = stack.http.post(f"/jobs/{job}/rerun", params={"dry_run": True}).json()["id"]
    assert stack.http.delete(f"/jobs/{job}/data").status_code == 204
    stack.wait_for(rerun, "succeeded")
