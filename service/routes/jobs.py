"""/jobs: submit, list, get, cancel, retry, rerun, remove, pin and follow jobs."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from redis import RedisError

from service.contract.archives import archive_path
from service.contract.jobs import FOUND_CAMERAS, FOUND_OBJECT
from service.contract.options import JobOptions
from service.contract.records import JobRecord, JobStatus, new_id, now
from service.contract.telemetry import current_traceparent
from service.events import EVENT_ID
from service.parts import OwnerDep, Parts, PartsDep, SnapshotDep
from service.polls import poll_answer
from service.problems import Problem, answers
from service.snapshots import Snapshot
from service.submissions import (
    LOCATION,
    DryRunQuery,
    OptionsQuery,
    accepted,
    answer,
    check_room,
    check_webhook,
    enqueue,
    parse_options,
)
from service.uploads import ARCHIVES, RAW_TYPES, Received, receive, too_large
from service.views import JobList, JobView

router = APIRouter(prefix="/jobs", tags=["jobs"])

_BINARY = {"schema": {"type": "string", "format": "binary"}}
_OPTIONS_EXAMPLE = '{"preset": "draft", "name": "vase"}'
_SUBMIT_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["archive"],
                    "additionalProperties": False,
                    "properties": {
                        "archive": {"type": "string", "format": "binary", "description": ARCHIVES},
                        "options": {
                            "type": "string",
                            "contentMediaType": "application/json",
                            "description": "JobOptions as JSON text",
                            "example": _OPTIONS_EXAMPLE,
                        },
                    },
                },
            },
            **{kind: _BINARY for kind in sorted(RAW_TYPES)},
        },
    }
}

_EVENT = {
    "type": "object",
    "description": "One event; data is JSON text.",
    "required": ["event", "data"],
    "properties": {
        "id": {"type": "string"},
        "event": {"type": "string", "enum": ["job", "progress", "status"]},
        "data": {"type": "string", "contentMediaType": "application/json"},
        "retry": {"type": "integer"},
    },
}

IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        description="A repeated request with the same key, archive and options returns the same job. The same key with "
        "another archive or other options returns 422.",
    ),
]
RerunQuery = Annotated[
    str | None,
    Query(max_length=16384, description="JobOptions as JSON text. Missing options are those of the earlier job."),
]


@router.post(
    "",
    status_code=202,
    response_model=JobView,
    openapi_extra=_SUBMIT_BODY,
    responses={202: {"description": "The queued job.", "headers": LOCATION}, **answers(408, 413, 415, 422, 429, 507)},
)
async def submit(
    request: Request,
    owner: OwnerDep,
    parts: PartsDep,
    idempotency_key: IdempotencyKey = None,
    options: OptionsQuery = None,
    dry_run: DryRunQuery = False,
) -> Response:
    """Submit a capture, which is an archive (zip, tar, tar.gz, tar.zst) of photographs or a video, with options."""
    asked = parse_options(options)
    check_webhook(asked, parts)
    await _check_request_room(request, owner, parts)
    job = _job_id(owner, idempotency_key)
    archive = archive_path(job, new_id())
    received = await receive(request, parts.jobs.store, archive, parts.settings)
    try:
        if received.options is not None:
            if options is not None:
                raise Problem(422, "bad_options", "expected options either in the query or in the body, got both")
            asked = parse_options(received.options)
            check_webhook(asked, parts)
        asked = asked.model_copy(update={"dry_run": asked.dry_run or dry_run})
        record = _record(job, owner, asked, archive, received)
        kept = await run_in_threadpool(parts.jobs.create, record)
    except Exception:
        await run_in_threadpool(parts.jobs.archives.delete, archive)
        raise
    return await accepted(parts, record, kept)


@router.get("", responses=answers(422))
async def list_jobs(
    owner: OwnerDep,
    parts: PartsDep,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[
        str | None, Query(pattern="^[0-9a-f]{32}$", description="The value `next` of the previous page.")
    ] = None,
) -> JobList:
    """List your jobs, the newest first, without their curves and findings."""
    ids = await run_in_threadpool(parts.jobs.owned, owner)
    first = ids.index(before) + 1 if before in ids else 0
    page = ids[first : first + limit]
    found = [await parts.snapshots.get(job) for job in page]
    more = page[-1] if page and first + limit < len(ids) else None
    views = [
        snapshot.view.model_copy(update={"curve": [], "findings": None}) for snapshot in found if snapshot is not None
    ]
    return JobList(jobs=views, next=more)


@router.get(
    "/{job_id}",
    response_model=JobView,
    responses={304: {"description": "The content is unchanged since the given ETag."}, **answers(404, 422)},
)
async def get_job(
    snapshot: SnapshotDep, if_none_match: Annotated[str | None, Header(max_length=1000)] = None
) -> Response:
    """Get a job: its status, its progress, the estimated time left, and any error."""
    return poll_answer(snapshot, if_none_match)


@router.delete(
    "/{job_id}",
    response_model=JobView,
    status_code=202,
    responses={200: {"model": JobView, "description": "Cancelled."}, **answers(404, 409, 422)},
)
async def cancel(snapshot: SnapshotDep, parts: PartsDep) -> Response:
    """Cancel a job. A running job stops within seconds, keeps its checkpoint, and can be retried."""
    job, number = snapshot.state.record.id, snapshot.state.round
    state = await run_in_threadpool(parts.jobs.state, job)
    assert state is not None
    if state.outcome is None:
        await run_in_threadpool(_cancel, parts, job, state.round)
    elif state.outcome.status is not JobStatus.CANCELLED:
        raise Problem(409, "job_ended", f"job {job} has already {state.outcome.status}")
    parts.snapshots.forget(job)
    now_known = await parts.snapshots.read(job)
    ended = now_known is not None and now_known.final and number == now_known.state.round
    return await answer(parts, job, 200 if ended else 202, {})


@router.post(
    "/{job_id}/retry",
    response_model=JobView,
    status_code=202,
    responses={202: {"description": "The job, which is queued again.", "headers": LOCATION}, **answers(404, 409, 422)},
)
async def retry(snapshot: SnapshotDep, parts: PartsDep) -> Response:
    """Retry a job that failed or was cancelled, from its last checkpoint."""
    job = snapshot.state.record.id
    state = await run_in_threadpool(parts.jobs.state, job)
    assert state is not None
    outcome = state.outcome
    if outcome is None or outcome.status is JobStatus.SUCCEEDED:
        raise Problem(409, "not_retryable", f"job {job} neither failed nor was cancelled, so there is nothing to retry")
    if outcome.error is not None and not outcome.error.retryable:
        raise Problem(
            409,
            "not_retryable",
            f"job {job} would fail again ({outcome.error.code}); fix the capture and submit it again",
        )
    await run_in_threadpool(parts.jobs.ask_retry, job, state.round + 1)
    await enqueue(parts, state.record, state.round + 1)
    return await answer(parts, job, 202, {})


@router.post(
    "/{job_id}/rerun",
    response_model=JobView,
    status_code=202,
    responses={
        202: {"description": "The new job, which is queued.", "headers": LOCATION},
        **answers(404, 410, 413, 422, 429, 507),
    },
)
async def rerun(
    snapshot: SnapshotDep,
    owner: OwnerDep,
    parts: PartsDep,
    idempotency_key: IdempotencyKey = None,
    options: RerunQuery = None,
) -> Response:
    """Submit the archive of an earlier job again with other options. Found cameras and masks are reused."""
    source = snapshot.state.record
    asked = _changed_options(source.options, options)
    check_webhook(asked, parts)
    await check_room(source.archive_bytes, owner, parts)
    record = _rerun_record(_job_id(owner, idempotency_key), source, asked)
    try:
        kept = await run_in_threadpool(_file_rerun, parts, source, record)
    except Exception:
        await run_in_threadpool(parts.jobs.archives.delete, record.archive)
        raise
    return await accepted(parts, record, kept)


@router.delete(
    "/{job_id}/data",
    status_code=204,
    responses={204: {"description": "The job and its files are deleted."}, **answers(404, 409, 422)},
)
async def remove(snapshot: SnapshotDep, parts: PartsDep) -> None:
    """Remove a job that has ended, with its archive and results."""
    job = snapshot.state.record.id
    state = await run_in_threadpool(parts.jobs.state, job)
    if state is not None and state.outcome is None:
        raise Problem(409, "job_open", f"job {job} is queued or running; cancel it first (DELETE /jobs/{job})")
    await run_in_threadpool(_remove, parts, snapshot.state.record)
    parts.snapshots.forget(job)


@router.put("/{job_id}/pin", response_model=JobView, responses=answers(404, 422))
async def pin(snapshot: SnapshotDep, parts: PartsDep) -> Response:
    """Keep a job beyond the retention, until it is unpinned or removed."""
    return await _set_pin(snapshot, parts, True)


@router.delete("/{job_id}/pin", response_model=JobView, responses=answers(404, 422))
async def unpin(snapshot: SnapshotDep, parts: PartsDep) -> Response:
    """Unpin a job, so that it is deleted after the retention."""
    return await _set_pin(snapshot, parts, False)


@router.get(
    "/{job_id}/events",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "`job` is the whole job, sent first and last. `progress` has the changed fields. `status` "
            "tells that the job ended.",
            "content": {"text/event-stream": {"schema": _EVENT}},
        },
        **answers(404, 422),
    },
)
async def events(
    snapshot: SnapshotDep,
    parts: PartsDep,
    last_event_id: Annotated[str | None, Header(max_length=50, pattern=EVENT_ID.pattern + "$")] = None,
) -> StreamingResponse:
    """Follow a job by server-sent events until it ends. With Last-Event-ID, missed events are sent again."""
    return StreamingResponse(
        parts.hub.follow(snapshot, last_event_id),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-cache", "X-Accel-Buffering": "no"},
    )


async def _set_pin(snapshot: Snapshot, parts: Parts, pinned: bool) -> Response:
    job = snapshot.state.record.id
    await run_in_threadpool(parts.jobs.pin, job, pinned)
    return await answer(parts, job, 200, {})


def _changed_options(earlier: JobOptions, text: str | None) -> JobOptions:
    """Return an earlier job's options, updated with those in the JSON text. Raises Problem if they are invalid.

    The rerun of a dry run is a real run, unless the text requests another dry run.
    """
    changes = parse_options(text).model_dump(mode="json", exclude_unset=True)
    return JobOptions.model_validate(earlier.model_dump(mode="json") | {"dry_run": False} | changes)


async def _check_request_room(request: Request, owner: str, parts: Parts) -> None:
    """Raise Problem if the request is too large, or its owner may not submit it now."""
    limit = parts.settings.max_upload
    text = request.headers.get("content-length", "0")
    length = int(text) if text.isascii() and text.isdigit() else 0
    if length > limit + (1 << 20):  # with an allowance for the multipart frame
        raise too_large(limit)
    await check_room(length, owner, parts)


def _job_id(owner: str, idempotency_key: str | None) -> str:
    """Return a new job id. With an idempotency key it is always the same.

    Of two submits with the same id, the store's create-only write accepts one.
    """
    if idempotency_key is None:
        return new_id()
    return hashlib.sha256(f"{owner}\0{idempotency_key}".encode()).hexdigest()[:32]


def _record(job: str, owner: str, options: JobOptions, archive: str, received: Received) -> JobRecord:
    payload = hashlib.sha256(f"{received.sha256}\0{options.model_dump_json()}".encode()).hexdigest()
    return JobRecord(
        id=job,
        owner=owner,
        created=now(),
        options=options,
        archive=archive,
        archive_bytes=received.size,
        payload_sha256=payload,
        traceparent=current_traceparent(),
    )


def _rerun_record(job: str, source: JobRecord, options: JobOptions) -> JobRecord:
    payload = hashlib.sha256(f"rerun {source.id}\0{options.model_dump_json()}".encode()).hexdigest()
    changes = {"id": job, "created": now(), "options": options, "payload_sha256": payload, "rerun_of": source.id}
    changes["traceparent"] = current_traceparent()
    return source.model_copy(update=changes | {"archive": archive_path(job, new_id())})


def _file_rerun(parts: Parts, source: JobRecord, record: JobRecord) -> JobRecord:
    """File a job with copies of another job's archive and found results. Returns the job on file.

    Raises Problem if the archive is gone.
    """
    earlier = parts.jobs.record(record.id)
    if earlier is not None:
        return earlier
    if not parts.jobs.archives.copy(source.archive, record.archive):
        raise Problem(
            410, "archive_gone", f"the archive of job {source.id} was deleted from the store; submit it again"
        )
    parts.jobs.take_over(source.id, record.id, FOUND_CAMERAS)
    if _same_object(source.options, record.options):
        parts.jobs.take_over(source.id, record.id, FOUND_OBJECT)
    return parts.jobs.create(record)


def _same_object(one: JobOptions, other: JobOptions) -> bool:
    """Return whether the object masks of one job also fit another job with these options.

    With other settings of reading, or a time budget, the photographs may have another size.
    """
    read = [
        {name: value for name, value in options.settings.items() if name.startswith("data.")}
        for options in (one, other)
    ]
    return read[0] == read[1] and "time_budget" not in one.settings | other.settings


def _cancel(parts: Parts, job: str, number: int) -> None:
    """Request a cancel, durably in the store and quickly in Redis. If no worker has the job, cancel it at once."""
    parts.jobs.ask_cancel(job, number)
    try:
        parts.live.ask_cancel(job, number)
        if not parts.live.leased(job):
            parts.jobs.cancel_now(job, number)
            parts.live.publish(job, "status", {"status": JobStatus.CANCELLED, "round": number})
    except RedisError:
        return  # recovery ends the round once the server is back


def _remove(parts: Parts, record: JobRecord) -> None:
    parts.jobs.remove(record)
    try:
        parts.live.forget(record.id)
    except RedisError:
        return  # the state expires by itself
