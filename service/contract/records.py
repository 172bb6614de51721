"""The documents of a job. All but previews, log and checkpoint are written once and never changed."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from service.contract.options import JobOptions


class JobStatus(StrEnum):
    """The status of a job. The last three are final, until a retry."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


class Document(BaseModel):
    """A JSON file in the store."""

    model_config = ConfigDict(frozen=True)

    def to_bytes(self) -> bytes:
        """Return the document in its form in the store."""
        return self.model_dump_json(indent=1).encode()


class JobRecord(Document):
    """The request of a job: job.json."""

    id: str
    owner: str
    created: datetime
    options: JobOptions
    archive: str  # key in the store
    archive_bytes: int
    payload_sha256: str  # of archive and options; an idempotency key belongs to one such hash
    traceparent: str | None = None  # of the submit's span (W3C Trace Context)
    rerun_of: str | None = None  # the job whose archive this one took over


class Failure(Document):
    """Why a job failed. code: a stable code for programs. message: for the user, with the remedy."""

    code: str = Field(examples=["bad_scene"])
    message: str
    retryable: bool = Field(description="Whether a retry of the same job may succeed.")
    peak_memory_bytes: int | None = None


class Artifact(Document):
    """A result file of an attempt."""

    name: str = Field(examples=["mesh.ply"])
    size: int
    sha256: str
    content_type: str


class Outcome(Document):
    """The outcome of a round of a job, which is a submit or a retry.

    With status succeeded, it is the manifest that publishes the attempt's artifacts.
    """

    status: JobStatus
    attempt: int | None
    finished: datetime
    error: Failure | None = None
    artifacts: list[Artifact] = []
    metrics: dict[str, Any] = {}
    findings: list[dict[str, Any]] | None = None  # what the check before training found


class AttemptStart(Document):
    """The start of an attempt: a worker took up a round."""

    round: int
    worker: str
    started: datetime


def now() -> datetime:
    """Return the current time, in UTC."""
    return datetime.now(UTC)


def new_id() -> str:
    """Return a new id that nobody can guess."""
    return secrets.token_hex(16)
