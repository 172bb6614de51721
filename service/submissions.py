"""The common part of all submits: check options, disk and limits, queue the job, and answer."""

from __future__ import annotations

import shutil
from typing import Annotated

from fastapi import Query, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from redis import RedisError

from service.contract.options import JobOptions
from service.contract.queue import queue_for
from service.contract.records import JobRecord
from service.contract.webhooks import names_private_host
from service.parts import Parts
from service.problems import Problem

LOCATION = {"Location": {"description": "The address of the job.", "schema": {"type": "string"}}}
OptionsQuery = Annotated[
    str | None,
    Query(max_length=16384, description="JobOptions as JSON text, if the body does not have them."),
]
DryRunQuery = Annotated[
    bool,
    Query(
        description="Only check the photographs and estimate the cost of each preset. The same as the option `dry_run`."
    ),
]


def parse_options(text: str | None) -> JobOptions:
    """Parse options from JSON text; None gives the defaults. Raises Problem if they are invalid."""
    try:
        return JobOptions.model_validate_json(text) if text else JobOptions()
    except ValidationError as error:
        found = [f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}" for item in error.errors()]
        raise Problem(422, "bad_options", "; ".join(found)[:4000]) from error


def check_webhook(options: JobOptions, parts: Parts) -> None:
    """Check that workers may call the webhook's address. Raises Problem otherwise."""
    if options.webhook is not None and not parts.settings.webhook_private and names_private_host(options.webhook):
        raise Problem(
            422,
            "webhook_refused",
            f"webhook: {options.webhook} is on this machine or its network; the service calls such addresses only "
            "with MGSR_WEBHOOK_PRIVATE=1",
        )


async def check_room(length: int, owner: str, parts: Parts) -> None:
    """Check that disk and owner have room for `length` more bytes. Raises Problem otherwise."""
    folder = parts.jobs.store.folder
    if folder is not None and shutil.disk_usage(folder).free < length + parts.settings.min_free_disk:
        raise Problem(
            507,
            "disk_full",
            "the disk of the service has no space for this upload; delete jobs (DELETE /jobs/{id}/data) or add space",
        )
    await run_in_threadpool(_check_limits, length, owner, parts)


def _check_limits(length: int, owner: str, parts: Parts) -> None:
    """Check the owner's limits of open jobs, with uploads, and of stored bytes. Raises Problem if one is exceeded."""
    settings, arriving = parts.settings, parts.uploads.owned(owner)
    opened = parts.jobs.open_of(owner) + len(arriving)
    if opened >= settings.max_open_jobs:
        raise Problem(
            429,
            "queue_full",
            f"{opened} of your jobs are queued, running or being uploaded, but the limit is {settings.max_open_jobs}; "
            "wait until one ends",
            {"Retry-After": "60"},
        )
    if settings.max_stored is None:
        return
    stored = parts.jobs.stored_of(owner) + sum(record.size for record in arriving)
    if stored + length > settings.max_stored:
        raise Problem(
            413,
            "storage_full",
            f"your jobs and uploads take {stored} bytes, and this one adds {length}, but the limit is "
            f"{int(settings.max_stored)}; delete jobs (DELETE /jobs/{{id}}/data)",
        )


async def accepted(parts: Parts, record: JobRecord, kept: JobRecord) -> Response:
    """Queue a new job, and answer with the job on file.

    Raises Problem if its idempotency key belongs to another submit.
    """
    if kept.archive == record.archive:
        await enqueue(parts, record, 0)
        return await answer(parts, record.id, 202, {})
    await run_in_threadpool(parts.jobs.archives.delete, record.archive)
    if kept.payload_sha256 != record.payload_sha256:
        raise Problem(
            422,
            "idempotency_conflict",
            f"this Idempotency-Key belongs to job {kept.id}, which has another archive or other options",
        )
    return await answer(parts, record.id, 202, {"Idempotency-Replayed": "true"})


async def enqueue(parts: Parts, record: JobRecord, number: int) -> None:
    """Queue a round of a job."""
    try:
        await run_in_threadpool(parts.queue.put, record.id, number, queue_for(record.options))
    except RedisError:
        return  # the job is in the store, and recovery queues it once the server is back


async def answer(parts: Parts, job: str, status: int, headers: dict[str, str]) -> Response:
    """Answer with the current state of a job, and its address."""
    parts.snapshots.forget(job)
    snapshot = await parts.snapshots.read(job)
    assert snapshot is not None
    body = snapshot.view.model_dump(mode="json")
    return JSONResponse(body, status, {"Location": f"/jobs/{job}", **headers})
