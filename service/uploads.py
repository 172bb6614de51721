"""Stream an archive or a video from a request to the store, with at most a few megabytes of it in memory."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from service.contract.settings import Settings
from service.contract.store import Store
from service.problems import Problem

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

OPTIONS_BYTES = 256 << 10
RAW_TYPES = {
    "application/zip",
    "application/x-zip-compressed",
    "application/x-tar",
    "application/gzip",
    "application/x-gzip",
    "application/zstd",
    "application/x-zstd",
    "application/octet-stream",
    "video/mp4",
    "video/quicktime",
    "video/webm",
    "video/x-matroska",
}
# The accepted kinds of files, for messages.
ARCHIVES = "zip, tar, tar.gz, tar.zst, or a video as mp4, mov, webm or mkv"
HEAD_BYTES = 512  # bytes, enough to tell the kind of an archive
# The first bytes of zip, gzip, zstd, and Matroska with WebM. Tar, mp4 and mov have their marks at other offsets.
_MAGIC = (b"PK", b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"\x1a\x45\xdf\xa3")
_MOVIES = (b"ftyp", b"moov", b"wide", b"mdat")


@dataclass(frozen=True)
class Received:
    """A received upload. options: the text of the multipart field, or None without one."""

    size: int
    sha256: str
    options: str | None


async def receive(request: Request, store: Store, key: str, settings: Settings) -> Received:
    """Store the request's archive under `key`. After an error, there is no object.

    Raises Problem: 400 cut off or malformed, 408 too slow, 413 too large, 415 unknown type, 422 no archive.
    """
    sink = _Sink(settings.max_upload)
    kind, parameters = parse_options_header(request.headers.get("content-type", ""))
    chunks = timed(request.stream(), settings)
    async with store.writer(key) as writer:
        if kind == b"multipart/form-data":
            options = await _multipart(chunks, parameters.get(b"boundary"), sink, writer)
        elif kind.decode("latin-1") in RAW_TYPES:
            options = None
            async for chunk in chunks:
                sink.take(chunk)
                await sink.flush(writer)
        else:
            raise Problem(
                415,
                "content_type_unsupported",
                f"expected multipart/form-data with a field `archive`, or one of {', '.join(sorted(RAW_TYPES))}; "
                f"got {kind.decode('latin-1', 'replace')[:100]!r}",
            )
        check_kind(sink.head)
        await sink.flush(writer)
    return Received(sink.size, sink.digest.hexdigest(), options)


class _Sink:
    """A buffer that counts and hashes the archive's bytes, and holds them until they are written."""

    def __init__(self, limit: int) -> None:
        self.limit, self.size, self.digest = limit, 0, hashlib.sha256()
        self._held: list[bytes] = []
        self.head = b""

    def take(self, chunk: bytes) -> None:
        self.size += len(chunk)
        if self.size > self.limit:
            raise too_large(self.limit)
        if len(self.head) < HEAD_BYTES:
            self.head += chunk[: HEAD_BYTES - len(self.head)]
            if len(self.head) >= HEAD_BYTES:
                check_kind(self.head)
        self.digest.update(chunk)
        self._held.append(chunk)

    async def flush(self, writer: Any) -> None:
        held, self._held = self._held, []
        for chunk in held:
            await writer.write(chunk)


def check_kind(head: bytes) -> None:
    """Check by its first bytes that a file is an archive or a video. The worker checks more. Raises Problem if not."""
    if not head:
        raise Problem(422, "archive_missing", f"the archive is empty; expected {ARCHIVES}")
    if not (head.startswith(_MAGIC) or head[257:262] == b"ustar" or head[4:8] in _MOVIES):
        raise Problem(422, "archive_unsupported", f"expected {ARCHIVES}, got other content")


def too_large(limit: int) -> Problem:
    """Return the problem for an upload of more than `limit` bytes."""
    return Problem(
        413, "archive_too_large", f"the upload exceeds the limit of {limit} bytes; use smaller or fewer images"
    )


async def timed(stream: AsyncIterator[bytes], settings: Settings) -> AsyncIterator[bytes]:
    """Yield the body's chunks. Raises Problem if none arrives for long, or the rate is too low."""
    started_at, count = time.monotonic(), 0
    while True:
        try:
            chunk = await asyncio.wait_for(anext(stream), settings.upload_idle)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise _too_slow(f"no data arrived for {settings.upload_idle:g} s") from None
        count += len(chunk)
        spent = time.monotonic() - started_at
        if spent > settings.upload_grace and count < spent * settings.upload_rate:
            raise _too_slow(f"{count / spent:.0f} bytes per second arrived, expected at least {settings.upload_rate}")
        yield chunk


def _too_slow(what: str) -> Problem:
    return Problem(408, "upload_too_slow", f"the upload was stopped: {what}; try again", {"Connection": "close"})


async def _multipart(chunks: AsyncIterator[bytes], boundary: bytes | None, sink: _Sink, writer: Any) -> str | None:
    """Pass the field `archive` to the sink, and return the field `options`."""
    if not boundary:
        raise Problem(400, "multipart_malformed", "expected a boundary in the header Content-Type, got none")
    fields = _Fields(sink)
    try:
        parser = MultipartParser(boundary, fields.callbacks())
        async for chunk in chunks:
            parser.write(chunk)
            await sink.flush(writer)
        parser.finalize()
    except MultipartParseError as error:
        raise Problem(400, "multipart_malformed", f"the multipart body cannot be read: {error}") from error
    if not fields.ended:
        raise Problem(400, "multipart_malformed", "the multipart body ends before its last boundary")
    if not fields.archive_seen:
        raise Problem(422, "archive_missing", f"expected a multipart field `archive` with {ARCHIVES}")
    return None if fields.options is None else _text(fields.options)


class _Fields:
    """The fields of a multipart body, collected by the parser's callbacks."""

    def __init__(self, sink: _Sink) -> None:
        self._sink = sink
        self._headers: dict[bytes, bytes] = {}
        self._name = self._value = b""
        self._field = b""
        self.options: bytes | None = None
        self.archive_seen = self.ended = False

    def callbacks(self) -> MultipartCallbacks:
        """Return the callbacks that the multipart parser calls."""
        return {
            "on_part_begin": self._begin,
            "on_header_field": self._header_name,
            "on_header_value": self._header_value,
            "on_header_end": self._header_end,
            "on_headers_finished": self._headers_end,
            "on_part_data": self._data,
            "on_end": self._end,
        }

    def _begin(self) -> None:
        self._headers = {}

    def _header_name(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _header_end(self) -> None:
        self._headers[self._name.lower()] = self._value
        self._name = self._value = b""

    def _headers_end(self) -> None:
        _, parameters = parse_options_header(self._headers.get(b"content-disposition", b""))
        self._field = parameters.get(b"name", b"")
        if (self._field == b"archive" and self.archive_seen) or (
            self._field == b"options" and self.options is not None
        ):
            raise Problem(400, "multipart_malformed", f"the field {self._field.decode()!r} appears twice")
        if self._field == b"archive":
            self.archive_seen = True
        elif self._field == b"options":
            self.options = b""
        else:
            raise Problem(
                422, "field_unknown", f"expected the fields `archive` and `options`, got {self._field[:100]!r}"
            )

    def _data(self, data: bytes, start: int, end: int) -> None:
        if self._field == b"archive":
            self._sink.take(data[start:end])
        else:
            self.options = (self.options or b"") + data[start:end]
            if len(self.options) > OPTIONS_BYTES:
                raise Problem(413, "options_too_large", f"the field `options` has more than {OPTIONS_BYTES} bytes")

    def _end(self) -> None:
        self.ended = True


def _text(data: bytes) -> str:
    with suppress(UnicodeDecodeError):
        return data.decode()
    raise Problem(422, "bad_options", "the field `options` is not UTF-8 text")
