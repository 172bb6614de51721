"""The service's API as method calls.

Requests to an unavailable server are repeated. A repeat submits nothing twice, because each submit has an idempotency
key. A large archive is sent as a resumable upload (tus 1.0), so a broken connection loses only the bytes in transit.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import httpx

from service.client.packing import packed
from service.client.unfinished import UnfinishedUploads, fingerprint

CHUNK = 1 << 18
# Larger archives are sent in requests of this size, because some proxies hold back a request until it is complete.
REQUEST_BYTES = 32 << 20
TRIES = 8
_AGAIN = {429, 502, 503, 504}
_GONE = {404, 410}  # the service does not have the upload, or a job has taken it
_APPEND_AGAIN = _AGAIN | {408, 409}  # the request was too slow, or had a wrong offset
_TUS = {"Tus-Resumable": "1.0.0"}

Job = dict[str, Any]
Progress = Callable[[int, int], None]


def ignore(done: int, total: int) -> None:
    """Ignore progress."""


class _TransferCounter:
    """A counter of transferred bytes, which reports their number."""

    def __init__(self, total: int, tell: Progress) -> None:
        self.done, self.total, self._tell = 0, total, tell

    def add(self, count: int) -> None:
        self.done += count
        self._tell(self.done, self.total)


class ServiceRefusal(Exception):
    """The service answered with a problem. code: a stable code for programs."""

    def __init__(self, status: int, code: str, detail: str) -> None:
        super().__init__(detail)
        self.status, self.code = status, code


class DamagedDownload(Exception):
    """A result file was damaged in transfer. The message names the file."""


class Client:
    """A client of one service. Use it in a `with` block.

    Its methods raise ServiceRefusal, and httpx.HTTPError if the service does not answer for long. unfinished: the
    folder for the addresses of interrupted uploads. The same submit continues them, even in another process. Without a
    folder, an interrupted upload is deleted.
    """

    def __init__(self, server: str, key: str | None = None, unfinished: Path | None = None) -> None:
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self._server, self._key, self._unfinished = server.rstrip("/"), key, UnfinishedUploads(unfinished)
        self._http = httpx.Client(base_url=self._server, headers=headers, timeout=60.0, follow_redirects=False)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def check(self) -> None:
        """Check once that the service answers."""
        _check(self._http.get("/healthz", timeout=10.0))

    def submit(self, scene: Path, options: Mapping[str, Any], sent: Progress = ignore) -> Job:
        """Send a folder or an archive of photographs, or a video, and return the job.

        options: as in `GET /options`. sent: receives the numbers of sent bytes and of all bytes. Raises SetupError if
        there is no scene.
        """
        with packed(scene) as archive:
            counter = _TransferCounter(archive.stat().st_size, sent)
            if counter.total > REQUEST_BYTES:
                return self._submit_resumable(archive, json.dumps(options), counter)
            return self._submit_at_once(archive, json.dumps(options), counter)

    def _submit_at_once(self, archive: Path, options: str, counter: _TransferCounter) -> Job:
        key = uuid.uuid4().hex

        def send() -> httpx.Response:
            counter.done = 0
            return self._http.post(
                "/jobs",
                params={"options": options},
                headers=_body_headers("application/octet-stream", counter.total) | {"Idempotency-Key": key},
                content=_chunks(archive, counter, counter.total),
            )

        created: Job = _again(send).json()
        return created

    def _submit_resumable(self, archive: Path, options: str, counter: _TransferCounter) -> Job:
        name = fingerprint(self._server, self._key, options, archive) if self._unfinished.kept else ""
        earlier = self._unfinished.find(name)
        if earlier is not None and (job := self._resume(name, earlier, archive, counter)) is not None:
            return job
        metadata = f"options {base64.b64encode(options.encode()).decode()}"
        headers = _TUS | {"Upload-Length": str(counter.total), "Upload-Metadata": metadata}
        address = _again(lambda: self._http.post("/uploads", headers=headers)).headers["Location"]
        self._unfinished.keep(name, address)
        return self._finish(name, address, archive, counter, 0)

    def _resume(self, name: str, address: str, archive: Path, counter: _TransferCounter) -> Job | None:
        """Continue an earlier upload and return its job; None if the service no longer has the upload."""
        try:
            try:
                arrived = self._arrived(address)
            except ServiceRefusal as refusal:
                if refusal.status not in _GONE:
                    raise
                arrived = counter.total  # a job may have taken it
            return self._finish(name, address, archive, counter, arrived)
        except ServiceRefusal as refusal:
            if refusal.status not in _GONE:
                raise
            return None

    def _finish(self, name: str, address: str, archive: Path, counter: _TransferCounter, arrived: int) -> Job:
        """Send the missing bytes of an upload, and return its job. name: the upload's fingerprint."""
        try:
            self._send_parts(address, archive, counter, arrived)
            created: Job = _again(lambda: self._http.post(f"{address}/job")).json()
        except BaseException as error:
            refused = isinstance(error, ServiceRefusal) and error.status not in _APPEND_AGAIN
            if refused or not self._unfinished.kept:
                self._unfinished.forget(name)
                with suppress(httpx.HTTPError):  # if this fails, the service deletes it later
                    self._http.delete(address, headers=_TUS, timeout=5.0)
            raise
        self._unfinished.forget(name)
        return created

    def _arrived(self, address: str) -> int:
        """Return the number of bytes of an upload that the service has received."""
        return int(_again(lambda: self._http.head(address, headers=_TUS)).headers["Upload-Offset"])

    def _send_parts(self, address: str, archive: Path, counter: _TransferCounter, arrived: int) -> None:
        """Send the rest of an archive to an upload. After an error, continue where the service's bytes end."""
        failures = 0
        while arrived < counter.total:
            try:
                answer = self._append(address, archive, arrived, counter)
                arrived, failures = int(answer.headers["Upload-Offset"]), 0
            except (httpx.TransportError, ServiceRefusal) as error:
                failures += 1
                if failures == TRIES or (isinstance(error, ServiceRefusal) and error.status not in _APPEND_AGAIN):
                    raise
                time.sleep(_pause(failures))
                known, arrived = arrived, self._arrived(address)
                failures = 0 if arrived > known else failures

    def _append(self, address: str, archive: Path, begin: int, counter: _TransferCounter) -> httpx.Response:
        """Send the next bytes of an upload."""
        counter.done = begin
        end = min(begin + REQUEST_BYTES, counter.total)
        headers = _TUS | {"Upload-Offset": str(begin)} | _body_headers("application/offset+octet-stream", end - begin)
        return _check(self._http.patch(address, headers=headers, content=_chunks(archive, counter, end)))

    def rerun(self, job: str, options: Mapping[str, Any]) -> Job:
        """Submit the archive of an earlier job again with these options, and return the new job.

        Options that are left out keep their values from the earlier job.
        """
        headers, params = {"Idempotency-Key": uuid.uuid4().hex}, {"options": json.dumps(options)}
        address = f"/jobs/{job}/rerun"
        created: Job = _again(lambda: self._http.post(address, params=params, headers=headers)).json()
        return created

    def jobs(self, limit: int = 50) -> list[Job]:
        """Return your jobs, the newest first."""
        found: list[Job] = _again(lambda: self._http.get("/jobs", params={"limit": limit})).json()["jobs"]
        return found

    def job(self, job: str) -> Job:
        """Return the job's current state."""
        state: Job = _again(lambda: self._http.get(f"/jobs/{job}")).json()
        return state

    def pin(self, job: str, pinned: bool = True) -> Job:
        """Pin a job, so that it outlasts the service's retention, or unpin it."""
        method = "PUT" if pinned else "DELETE"
        state: Job = _again(lambda: self._http.request(method, f"/jobs/{job}/pin")).json()
        return state

    def cancel(self, job: str) -> Job:
        """Ask the service to cancel the job."""
        state: Job = _again(lambda: self._http.delete(f"/jobs/{job}")).json()
        return state

    def artifacts(self, job: str) -> list[dict[str, Any]]:
        """Return the name, size and sha256 of each result file."""
        artifacts: list[dict[str, Any]] = _again(lambda: self._http.get(f"/jobs/{job}/artifacts")).json()["artifacts"]
        return artifacts

    def fetch(self, job: str, out: Path, got: Progress = ignore) -> list[Path]:
        """Fetch every result of a job into a folder, and return the files.

        got: receives the numbers of fetched bytes and of all bytes. Raises DamagedDownload if a SHA-256 differs.
        """
        artifacts = self.artifacts(job)
        counter = _TransferCounter(sum(artifact["size"] for artifact in artifacts), got)
        for artifact in artifacts:
            self.download(job, artifact, out / artifact["name"], counter.add)
        return [out / artifact["name"] for artifact in artifacts]

    def download(self, job: str, artifact: dict[str, Any], path: Path, got: Callable[[int], None]) -> None:
        """Download a result file, check it, and write it to `path` atomically. An interrupted download resumes.

        got: receives each chunk's size. Raises DamagedDownload if the SHA-256 differs.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.partial")
        with partial.open("w+b") as file:
            failures = 0
            while (begin := file.tell()) < artifact["size"]:
                try:
                    self._receive(f"/jobs/{job}/artifacts/{artifact['name']}", file, got)
                except httpx.TransportError:
                    failures = failures + 1 if file.tell() == begin else 1
                    if failures == TRIES:
                        raise
                    time.sleep(_pause(failures))
            file.seek(0)
            if hashlib.file_digest(file, "sha256").hexdigest() != artifact["sha256"]:
                raise DamagedDownload(f"{path}: the download is damaged; fetch it again")
        os.replace(partial, path)

    def _receive(self, address: str, file: BinaryIO, got: Callable[[int], None]) -> None:
        """Append the missing bytes of a download to the file."""
        begin = file.tell()
        headers = {"Range": f"bytes={begin}-"} if begin else {}
        plain = _again(lambda: self._http.send(self._http.build_request("GET", address, headers=headers), stream=True))
        with closing(plain):
            if plain.status_code != 307:
                _append(plain, file, got)
                return
        with httpx.stream("GET", plain.headers["Location"], headers=headers, timeout=60.0) as other:  # without the key
            _append(_check(other), file, got)

    def follow(self, job: str) -> Iterator[Job]:
        """Yield the job's changed fields, and last the whole job. Resumes if the connection breaks."""
        last, known = "", self.job(job)
        yield known
        while known["status"] in ("queued", "running"):
            headers = {"Last-Event-ID": last} if last else {}
            try:
                with self._http.stream("GET", f"/jobs/{job}/events", headers=headers, timeout=40.0) as answer:
                    _check(answer)
                    for number, data in _events(answer.iter_lines()):
                        last = number or last
                        known |= data
                        yield known
            except httpx.HTTPError:
                time.sleep(1.0)
            known = self.job(job)
        yield known


def _events(lines: Iterator[str]) -> Iterator[tuple[str, Job]]:
    """Yield the id and the data of each event that changes the displayed state."""
    number = kind = data = ""
    for line in lines:
        field, _, value = line.partition(": ")
        if field == "id":
            number = value
        elif field == "event":
            kind = value
        elif field == "data":
            data = value
        elif not line and data:
            if kind in ("job", "progress"):
                yield number, json.loads(data)
            number = kind = data = ""


def _append(answer: httpx.Response, file: BinaryIO, got: Callable[[int], None]) -> None:
    if answer.status_code != 206 and file.tell() > 0:  # a server without ranges sends the whole file again
        got(-file.tell())
        file.seek(0)
        file.truncate()
    for chunk in answer.iter_bytes():
        file.write(chunk)
        got(len(chunk))


def _pause(failures: int) -> float:
    """Return the seconds to wait after a number of failures in a row."""
    return min(0.5 * 2.0 ** (failures - 1), 8.0)


def _again(send: Callable[[], httpx.Response]) -> httpx.Response:
    """Send a request until the server is neither unavailable nor busy; return the answer or raise the last error."""
    for attempt in range(TRIES):
        try:
            answer = send()
        except httpx.TransportError:
            if attempt == TRIES - 1:
                raise
        else:
            if answer.status_code not in _AGAIN or attempt == TRIES - 1:
                return _check(answer)
        time.sleep(_pause(attempt + 1))
    raise AssertionError("unreachable")


def _check(answer: httpx.Response) -> httpx.Response:
    if answer.status_code < 400:
        return answer
    answer.read()
    try:
        problem = answer.json()
        raise ServiceRefusal(answer.status_code, problem["code"], problem["detail"])
    except (ValueError, KeyError, TypeError):
        raise ServiceRefusal(answer.status_code, "unknown", f"HTTP {answer.status_code}: {answer.text[:200]}") from None


def _body_headers(kind: str, size: int) -> dict[str, str]:
    return {"Content-Type": kind, "Content-Length": str(size)}


def _chunks(path: Path, counter: _TransferCounter, end: int) -> Iterator[bytes]:
    """Yield the file's bytes from the counter's position up to `end`."""
    with path.open("rb") as file:
        file.seek(counter.done)
        while chunk := file.read(min(CHUNK, end - counter.done)):
            yield chunk
            counter.add(len(chunk))
