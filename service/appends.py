"""Receive a request's bytes into parts of an archive, so that a broken connection loses no received bytes."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import AsyncIterator
from contextlib import suppress

from fastapi.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from service.contract.archives import new_part
from service.contract.resumable import UploadState
from service.contract.settings import Settings
from service.contract.store import Store
from service.problems import Problem
from service.uploads import HEAD_BYTES, check_kind, timed

# The bytes of a part. If the service itself is killed, at most one part is lost.
PART_BYTES = 32 << 20
CHECKSUMS = ("sha1", "sha256", "sha512")
CHECKSUM_MISMATCH = 460  # defined by tus, not by HTTP


class Checksum:
    """The expected checksum of one request's bytes: the algorithm, a blank, and the sum in base64."""

    def __init__(self, text: str) -> None:
        """Parse the header Upload-Checksum. Raises Problem if it is malformed."""
        name, _, encoded = text.partition(" ")
        with suppress(binascii.Error):
            if name in CHECKSUMS:
                self.digest, self._expected = hashlib.new(name), base64.b64decode(encoded, validate=True)
                return
        raise Problem(
            400,
            "checksum_unsupported",
            f"Upload-Checksum: expected one of {', '.join(CHECKSUMS)}, a blank and the sum in base64; "
            f"got {text[:100]!r}",
        )

    def compare(self) -> None:
        """Compare the checksum with that of the received bytes. Raises Problem if they differ."""
        if self.digest.digest() != self._expected:
            raise Problem(
                CHECKSUM_MISMATCH,
                "checksum_mismatch",
                "the bytes of this request do not have the sum in Upload-Checksum, and are dropped; send them again",
            )


async def append(
    request: Request, store: Store, state: UploadState, settings: Settings, checksum: Checksum | None
) -> int:
    """Append the request's bytes to an upload, and return the upload's new size in bytes.

    If the connection breaks or is too slow, the arrived bytes are kept. With a checksum they are dropped, because it
    covers the whole request. Raises ClientDisconnect, and Problem: 408 too slow, 413 too many bytes, 422 unknown type,
    460 another checksum.
    """
    body = _AppendedBody(timed(request.stream(), settings), state, checksum)
    end, keys = state.offset, []
    try:
        while chunk := await body.read():
            keys.append(new_part(state.record.archive, end))
            end += await _write_part(store, keys[-1], chunk, body)
        if body.trouble is not None:
            raise body.trouble
        if checksum is not None:
            checksum.compare()
    except (Problem, ClientDisconnect):
        if checksum is not None:
            for key in keys:
                await run_in_threadpool(store.delete, key)
        raise
    return end


async def _write_part(store: Store, key: str, chunk: bytes, body: _AppendedBody) -> int:
    """Write one part that begins with this chunk, and return its size."""
    size = 0
    async with store.writer(key) as writer:
        while chunk:
            await writer.write(chunk)
            size += len(chunk)
            chunk = await body.read() if size < PART_BYTES else b""
    return size


class _AppendedBody:
    """A request's body, whose bytes are counted and checked. trouble: the error that ended it early."""

    def __init__(self, chunks: AsyncIterator[bytes], state: UploadState, checksum: Checksum | None) -> None:
        self._chunks, self._checksum = chunks, checksum
        self._left = state.record.size - state.offset
        self._head: bytes | None = None if state.offset else b""  # None: the type is known
        self.trouble: Problem | ClientDisconnect | None = None

    async def read(self) -> bytes:
        """Return the next bytes, or b"" at the end. Raises Problem for bytes that don't belong to the upload."""
        try:
            chunk = b""
            while not chunk and self.trouble is None:
                chunk = await anext(self._chunks)
        except StopAsyncIteration:
            return b""
        except (Problem, ClientDisconnect) as trouble:
            self.trouble = trouble
            return b""
        self._left -= len(chunk)
        if self._left < 0:
            raise too_long()
        if self._head is not None:
            self._look_at_head(chunk)
        if self._checksum is not None:
            self._checksum.digest.update(chunk)
        return chunk

    def _look_at_head(self, chunk: bytes) -> None:
        assert self._head is not None
        self._head += chunk[: HEAD_BYTES - len(self._head)]
        if len(self._head) == HEAD_BYTES or self._left == 0:
            check_kind(self._head)
            self._head = None


def too_long() -> Problem:
    """Return the problem for more bytes than the upload's announced size."""
    return Problem(413, "upload_too_long", "the request has more bytes than Upload-Length leaves room for")
