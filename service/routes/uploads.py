"""/uploads: archives in several requests, by the tus protocol 1.0 (https://tus.io/protocols/resumable-upload).

Extensions: creation, termination, expiration, checksum. `POST /uploads/{id}/job` makes a job of a complete upload.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Callable, Coroutine
from email.utils import format_datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.routing import APIRoute

from service.appends import CHECKSUM_MISMATCH, CHECKSUMS, Checksum, append, too_long
from service.contract.options import JobOptions
from service.contract.records import JobRecord, now
from service.contract.resumable import UploadRecord, UploadState, job_of
from service.contract.telemetry import current_traceparent
from service.parts import OwnerDep, PartsDep
from service.problems import Problem, answers
from service.submissions import (
    LOCATION,
    DryRunQuery,
    OptionsQuery,
    answer,
    check_room,
    check_webhook,
    enqueue,
    parse_options,
)
from service.uploads import too_large
from service.views import JobView

VERSION = "1.0.0"
APPEND_TYPE = "application/offset+octet-stream"
_METADATA_BYTES = 32 << 10


async def _speaks_tus(tus_resumable: Annotated[str, Header(max_length=100, description="1.0.0")] = "") -> None:
    if tus_resumable != VERSION:
        raise Problem(
            412,
            "tus_version",
            f"expected the header `Tus-Resumable: {VERSION}`, got {tus_resumable!r}",
            {"Tus-Version": VERSION},
        )


class _TusRoute(APIRoute):
    """A route that names the protocol's version in every answer."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the route's handler."""
        handle = super().get_route_handler()

        async def handler(request: Request) -> Response:
            try:
                found = await handle(request)
            except Problem as problem:
                found = problem.response()
            found.headers["Tus-Resumable"] = VERSION
            return found

        return handler


router = APIRouter(prefix="/uploads", tags=["uploads"], route_class=_TusRoute)
_TUS = [Depends(_speaks_tus)]


async def _own_upload(upload_id: str, owner: OwnerDep, parts: PartsDep) -> UploadState:
    state = await run_in_threadpool(parts.uploads.state, owner, upload_id)
    if state is None:
        raise Problem(
            404,
            "upload_unknown",
            f"you have no upload {upload_id[:64]!r}; it expired, was deleted, or a job has taken it",
        )
    if state.expired:
        raise Problem(
            410,
            "upload_expired",
            f"the upload {upload_id} expired at {state.expires:%Y-%m-%d %H:%M} UTC; begin a new one",
        )
    return state


UploadDep = Annotated[UploadState, Depends(_own_upload)]
UploadLength = Annotated[int, Header(ge=1, description="The size of the whole archive, in bytes.")]
UploadOffset = Annotated[int, Header(ge=0, description="The number of received bytes, at which the request continues.")]
UploadMetadata = Annotated[
    str,
    Header(
        max_length=_METADATA_BYTES,
        description="Pairs of a name and a value in base64. `options`: the JobOptions as JSON text.",
    ),
]
_TEXT = {"schema": {"type": "string"}}


def _described(status: int, text: str, *headers: str) -> dict[int | str, dict[str, Any]]:
    return {status: {"description": text, "headers": {name: _TEXT for name in ("Tus-Resumable", *headers)}}}


@router.options(
    "",
    status_code=204,
    responses=_described(204, "The supported features.", "Tus-Version", "Tus-Extension", "Tus-Max-Size"),
)
async def describe_uploads(parts: PartsDep) -> Response:
    """Get the protocol version, the extensions and the size limit of resumable uploads."""
    headers = {
        "Tus-Version": VERSION,
        "Tus-Extension": "creation,termination,expiration,checksum",
        "Tus-Checksum-Algorithm": ",".join(CHECKSUMS),
        "Tus-Max-Size": str(int(parts.settings.max_upload)),
    }
    return Response(status_code=204, headers=headers)


@router.post(
    "",
    dependencies=_TUS,
    status_code=201,
    responses={
        **_described(201, "The new upload.", "Location", "Upload-Expires"),
        **answers(412, 413, 422, 429, 507),
    },
)
async def create_upload(
    owner: OwnerDep, parts: PartsDep, upload_length: UploadLength, upload_metadata: UploadMetadata = ""
) -> Response:
    """Begin an upload of a known size. Options in the metadata are checked at once."""
    if upload_length > parts.settings.max_upload:
        raise too_large(parts.settings.max_upload)
    options = _options(upload_metadata)
    if options is not None:
        check_webhook(options, parts)
    await check_room(upload_length, owner, parts)
    state = await run_in_threadpool(parts.uploads.create, owner, upload_length, options)
    return Response(status_code=201, headers=_headers(state) | {"Location": f"/uploads/{state.record.id}"})


@router.head(
    "/{upload_id}",
    dependencies=_TUS,
    responses={
        **_described(200, "The state of the upload.", "Upload-Offset", "Upload-Length", "Upload-Expires"),
        **answers(404, 410, 412, 422),
    },
)
async def get_upload(state: UploadDep) -> Response:
    """Get the number of received bytes."""
    headers = {"Upload-Length": str(state.record.size), "Cache-Control": "no-store"}
    return Response(headers=_headers(state) | headers)


@router.patch(
    "/{upload_id}",
    dependencies=_TUS,
    status_code=204,
    openapi_extra={
        "requestBody": {"required": True, "content": {APPEND_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
    },
    responses={
        **_described(204, "The bytes have arrived.", "Upload-Offset", "Upload-Expires"),
        **answers(404, 408, 409, 410, 412, 413, 415, 422),
        CHECKSUM_MISMATCH: answers(422)[422] | {"description": "Checksum Mismatch"},
    },
)
async def append_to_upload(
    request: Request,
    parts: PartsDep,
    state: UploadDep,
    upload_offset: UploadOffset,
    upload_checksum: Annotated[str | None, Header(max_length=200)] = None,
) -> Response:
    """Append the body to the upload. If the connection breaks, the received bytes are kept."""
    kind = request.headers.get("content-type", "")
    if kind != APPEND_TYPE:
        raise Problem(415, "content_type_unsupported", f"expected {APPEND_TYPE}, got {kind[:100]!r}")
    if upload_offset != state.offset:
        raise Problem(
            409,
            "upload_offset",
            f"Upload-Offset: expected {state.offset}, the number of received bytes, got {upload_offset}",
            _headers(state),
        )
    length = request.headers.get("content-length", "")
    if length.isascii() and length.isdigit() and int(length) > state.record.size - state.offset:
        raise too_long()
    checksum = None if upload_checksum is None else Checksum(upload_checksum)
    await append(request, parts.jobs.store, state, parts.settings, checksum)
    now_known = await run_in_threadpool(parts.uploads.state, state.record.owner, state.record.id)
    return Response(status_code=204, headers=_headers(now_known or state))


@router.delete(
    "/{upload_id}",
    dependencies=_TUS,
    status_code=204,
    responses={**_described(204, "The upload and its bytes are deleted."), **answers(404, 410, 412, 422)},
)
async def delete_upload(parts: PartsDep, state: UploadDep) -> Response:
    """Abandon an upload, and delete its bytes."""
    await run_in_threadpool(parts.uploads.remove, state.record)
    return Response(status_code=204)


@router.post(
    "/{upload_id}/job",
    status_code=202,
    response_model=JobView,
    responses={202: {"description": "The queued job.", "headers": LOCATION}, **answers(404, 409, 410, 422)},
)
async def submit_upload(
    upload_id: str, owner: OwnerDep, parts: PartsDep, options: OptionsQuery = None, dry_run: DryRunQuery = False
) -> Response:
    """Make a job of a complete upload. An upload makes one job, so a repeated request returns the same job."""
    earlier = await run_in_threadpool(parts.jobs.record, job_of(owner, upload_id))
    if earlier is not None:
        return await answer(parts, earlier.id, 202, {"Idempotency-Replayed": "true"})
    state = await _own_upload(upload_id, owner, parts)
    if not state.complete:
        raise Problem(
            409, "upload_incomplete", f"{state.offset} of {state.record.size} bytes have arrived; send the rest first"
        )
    asked = parse_options(options) if options is not None else state.record.options or JobOptions()
    check_webhook(asked, parts)
    record = _record(state.record, asked.model_copy(update={"dry_run": asked.dry_run or dry_run}))
    kept = await run_in_threadpool(parts.jobs.create, record)
    await run_in_threadpool(parts.uploads.taken, state.record)
    await enqueue(parts, kept, 0)
    return await answer(parts, kept.id, 202, {})


def _record(upload: UploadRecord, options: JobOptions) -> JobRecord:
    return JobRecord(
        id=upload.job,
        owner=upload.owner,
        created=now(),
        options=options,
        archive=upload.archive,
        archive_bytes=upload.size,
        traceparent=current_traceparent(),
        payload_sha256=hashlib.sha256(f"upload {upload.id}\0{options.model_dump_json()}".encode()).hexdigest(),
    )


def _headers(state: UploadState) -> dict[str, str]:
    expires = format_datetime(state.expires, usegmt=True)
    return {"Upload-Offset": str(state.offset), "Upload-Expires": expires}


def _options(metadata: str) -> JobOptions | None:
    """Return the options in Upload-Metadata, or None if there are none. Raises Problem if they are invalid."""
    pairs = dict(pair.strip().partition(" ")[::2] for pair in metadata.split(",") if pair.strip())
    if "options" not in pairs:
        return None
    try:
        return parse_options(base64.b64decode(pairs["options"], validate=True).decode())
    except (binascii.Error, UnicodeDecodeError) as error:
        raise Problem(422, "bad_options", "Upload-Metadata: `options` is not UTF-8 text in base64") from error
