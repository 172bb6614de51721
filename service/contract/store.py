"""The artifact store: a folder, or a bucket of an S3 service. Keys are paths with slashes."""

from __future__ import annotations

import shutil
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import LocalStore, S3Store

from service.contract.errors import StoreError

PART = 5 << 20  # bytes that one upload holds in memory; S3 takes no smaller parts
SIGNED_SECONDS = 900


@dataclass(frozen=True)
class Entry:
    """An object in a listing."""

    key: str
    size: int
    modified: datetime


class Store:
    """Objects by key. Writes are atomic. Every method raises StoreError if the store fails."""

    def __init__(self, url: str, patience: float) -> None:
        """Open the store at `url`.

        url: a folder's path or s3://bucket/prefix, with the usual AWS_* variables. patience: seconds for which failed
        requests are repeated.
        """
        self.folder: Path | None = None
        self._backend: LocalStore | S3Store
        if url.startswith("s3://"):
            self._backend = _open_s3(url, patience)
        else:
            self.folder = Path(url).expanduser().absolute()
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._backend = LocalStore(self.folder)

    def read(self, key: str) -> bytes | None:
        """Return the object, or None if there is none."""
        with _failures(key):
            try:
                return bytes(obstore.get(self._backend, key).bytes())
            except FileNotFoundError:
                return None

    def create(self, key: str, data: bytes) -> bool:
        """Write an object unless it exists, and return whether the key holds this data afterwards.

        If the answer to a request gets lost, the repeated request finds its own object. That counts as written.
        """
        with _failures(key):
            try:
                obstore.put(self._backend, key, data, mode="create")
                return True
            except AlreadyExistsError:
                return self.read(key) == data

    def replace(self, key: str, data: bytes) -> None:
        """Write an object, replacing any that exists."""
        with _failures(key):
            obstore.put(self._backend, key, data)

    def copy(self, key: str, target: str) -> bool:
        """Copy an object to another key, and return whether it existed."""
        with _failures(key):
            try:
                obstore.copy(self._backend, key, target)
                return True
            except FileNotFoundError:
                return False

    def delete(self, key: str) -> None:
        """Delete an object, if it exists."""
        with _failures(key):
            try:
                obstore.delete(self._backend, key)
            except FileNotFoundError:
                return

    def delete_all(self, prefix: str) -> None:
        """Delete every object under `prefix`. In a folder, also delete the unfinished files of killed processes."""
        for entry in list(self.entries(prefix)):
            self.delete(entry.key)
        if self.folder is not None:
            shutil.rmtree(self.folder / prefix, ignore_errors=True)

    def delete_unfinished(self, prefix: str, age: float) -> None:
        """Delete the unfinished files of killed processes in a folder, if they are older than `age` seconds.

        A bucket has a lifecycle rule for that.
        """
        if self.folder is None:
            return
        for path in (self.folder / prefix).rglob("*#*"):  # obstore's names of unfinished files
            with suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime > age:
                    path.unlink()

    def entries(self, prefix: str) -> Iterator[Entry]:
        """Yield every object under the folder `prefix`, in no order."""
        with _failures(prefix):
            for batch in obstore.list(self._backend, prefix=prefix):
                yield from (Entry(item["path"], item["size"], item["last_modified"]) for item in batch)

    def names(self, prefix: str) -> list[str]:
        """Return the keys under the folder `prefix`, without it."""
        return [entry.key.removeprefix(prefix).lstrip("/") for entry in self.entries(prefix)]

    def upload(self, key: str, path: Path) -> None:
        """Write a file's content to an object, in several parts if it is large."""
        with _failures(key):
            obstore.put(self._backend, key, path, chunk_size=PART, max_concurrency=2)

    def download(self, path: Path, *keys: str) -> None:
        """Write objects to a file, one after another. Raises StoreError if one does not exist."""
        with open(path, "wb") as file:
            for key in keys:
                with _failures(key):
                    for chunk in obstore.get(self._backend, key).stream(min_chunk_size=PART):
                        file.write(chunk)

    @asynccontextmanager
    async def writer(self, key: str) -> AsyncIterator[Any]:
        """Yield an asynchronous writer of one object: `await write(bytes)`.

        It drops everything if the block ends by an exception.
        """
        with _failures(key):
            async with obstore.open_writer_async(self._backend, key, buffer_size=PART, max_concurrency=1) as writer:
                yield writer

    async def stream(self, key: str, start: int, end: int) -> AsyncIterator[bytes]:
        """Yield the bytes from `start` up to, but not including, `end`."""
        with _failures(key):
            found = await obstore.get_async(self._backend, key, options={"range": (start, end)})
            async for chunk in found.stream(min_chunk_size=1 << 18):
                yield bytes(chunk)

    def signed_url(self, key: str) -> str | None:
        """Return a URL at which anyone can get the object for SIGNED_SECONDS, or None if the store is a folder."""
        if not isinstance(self._backend, S3Store):
            return None
        with _failures(key):
            return str(obstore.sign(self._backend, "GET", key, timedelta(seconds=SIGNED_SECONDS)))

    def check(self) -> None:
        """Check that the store answers. Raises StoreError otherwise."""
        self.read("health")


def _open_s3(url: str, patience: float) -> S3Store:
    bucket, _, prefix = url.removeprefix("s3://").partition("/")
    return S3Store(
        bucket,
        prefix=prefix or None,
        client_options={"allow_http": True, "connect_timeout": timedelta(seconds=3), "timeout": timedelta(seconds=60)},
        retry_config={
            "max_retries": 1000,
            "retry_timeout": timedelta(seconds=patience),
            "backoff": {
                "init_backoff": timedelta(milliseconds=100),
                "max_backoff": timedelta(seconds=2),
                "base": 2,
            },
        },
    )


@contextmanager
def _failures(key: str) -> Iterator[None]:
    try:
        yield
    except (BaseError, OSError) as error:
        reason = str(error).split("\n", 1)[0]
        raise StoreError(f"store: {key}: {reason}") from error
