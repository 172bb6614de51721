"""Uploads that arrive in several requests, until a job takes them.

resumable/<owner>/<upload>.json    the upload's record; its parts are in the folder of the job's archive (archives.py)
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta

from service.contract.archives import Archives, archive_path
from service.contract.options import JobOptions
from service.contract.records import Document, new_id, now
from service.contract.store import Store

FOLDER = "resumable"
_ID = re.compile(r"[0-9a-f]{32}")


class UploadRecord(Document):
    """The record of an upload. size: the announced size in bytes. options: the job's options, if they are known."""

    id: str
    owner: str
    created: datetime
    size: int
    options: JobOptions | None = None

    @property
    def job(self) -> str:
        """Return the id of the job that takes the upload."""
        return job_of(self.owner, self.id)

    @property
    def archive(self) -> str:
        """Return the key of the archive that holds its bytes."""
        return archive_path(self.job, self.id)


@dataclass(frozen=True)
class UploadState:
    """An upload and the number of received bytes. expires: when it is deleted, unless more bytes arrive."""

    record: UploadRecord
    offset: int
    expires: datetime

    @property
    def complete(self) -> bool:
        """Return whether all bytes have arrived."""
        return self.offset == self.record.size

    @property
    def expired(self) -> bool:
        """Return whether the upload has expired."""
        return now() > self.expires


class ResumableUploads:
    """The uploads of one store that no job has taken yet. lifetime: seconds from the last part to the deletion."""

    def __init__(self, store: Store, lifetime: float) -> None:
        self._store, self._archives, self._lifetime = store, Archives(store), timedelta(seconds=lifetime)

    def create(self, owner: str, size: int, options: JobOptions | None) -> UploadState:
        """Begin an upload of `size` bytes."""
        record = UploadRecord(id=new_id(), owner=owner, created=now(), size=size, options=options)
        self._store.create(_path(owner, record.id), record.to_bytes())
        return UploadState(record, 0, record.created + self._lifetime)

    def state(self, owner: str, upload: str) -> UploadState | None:
        """Return an owner's upload, or None for an unknown id."""
        data = self._store.read(_path(owner, upload)) if _ID.fullmatch(upload) else None
        if data is None:
            return None
        record = UploadRecord.model_validate_json(data)
        parts = self._archives.parts(record.archive)
        last = max((part.modified for part in parts), default=record.created)
        return UploadState(record, sum(part.size for part in parts), last + self._lifetime)

    def owned(self, owner: str) -> list[UploadRecord]:
        """Return an owner's uploads."""
        return list(self._records(f"{FOLDER}/{owner}"))

    def taken(self, record: UploadRecord) -> None:
        """Delete the record of an upload whose archive a job has taken."""
        self._store.delete(_path(record.owner, record.id))

    def remove(self, record: UploadRecord) -> None:
        """Delete an upload and its bytes."""
        self._archives.delete(record.archive)
        self._store.delete(_path(record.owner, record.id))

    def sweep(self) -> None:
        """Delete the uploads that have expired."""
        for record in self._records(FOLDER):
            state = self.state(record.owner, record.id)
            if state is None or not state.expired:
                continue
            if self._store.read(f"jobs/{record.job}/job.json") is None:
                self.remove(record)
            else:  # the service was killed just after it had made the job
                self.taken(record)

    def _records(self, folder: str) -> Iterator[UploadRecord]:
        for entry in list(self._store.entries(folder)):
            if (data := self._store.read(entry.key)) is not None:
                yield UploadRecord.model_validate_json(data)


def archives_on_the_way(store: Store) -> set[str]:
    """Return the keys of the archives of all unfinished uploads."""
    names = (name.removesuffix(".json").split("/") for name in store.names(FOLDER))
    return {archive_path(job_of(owner, upload), upload) for owner, upload in names}


def job_of(owner: str, upload: str) -> str:
    """Return the id of the only job that can take an upload."""
    return hashlib.sha256(f"{owner}\0upload {upload}".encode()).hexdigest()[:32]


def _path(owner: str, upload: str) -> str:
    return f"{FOLDER}/{owner}/{upload}.json"
