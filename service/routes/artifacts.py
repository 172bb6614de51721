"""/jobs/{id}/...: the results of a job."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import RedirectResponse, StreamingResponse
from pydantic import BaseModel

from service.contract.jobs import attempt_path
from service.contract.photographs import CheckedPhotographs
from service.contract.records import Artifact, JobStatus
from service.parts import Parts, PartsDep, SnapshotDep
from service.problems import Problem, answers
from service.ranges import parse_range
from service.routes.page import REPORT_POLICY
from service.snapshots import Snapshot

router = APIRouter(prefix="/jobs/{job_id}", tags=["results"])

# Names that stand for the first of these files that exists.
ALIASES = {"splats.ply": ("splats_3d.ply", "splats_2d.ply")}
BINARY = "application/octet-stream"
SINGLE = {
    "mesh.ply": BINARY,
    "model.glb": "model/gltf-binary",
    "model_draco.glb": "model/gltf-binary",
    "model.usdz": "model/vnd.usdz+zip",
    "environment.exr": "image/x-exr",
    "splats.ply": BINARY,
    "splats_2d.ply": BINARY,
    "splats_3d.ply": BINARY,
    "report.html": "text/html",
    "report.json": "application/json",
}


class ArtifactList(BaseModel):
    """The result files of a job that has succeeded."""

    artifacts: list[Artifact]


def _file(kind: str) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of a route that sends a file of media type `kind`."""
    schema = {"type": "object"} if kind == "application/json" else {"type": "string", "format": "binary"}
    content = {kind: {"schema": schema}}
    return {
        200: {"description": "The file.", "content": content},
        206: {"description": "The requested range.", "content": content},
        304: {"description": "The content is unchanged since the given ETag."},
        307: {"description": "The file is at this address for 15 minutes."},
        **answers(404, 416, 422),
    }


RangeHeader = Annotated[str | None, Header(alias="Range", max_length=200)]
IfNoneMatch = Annotated[str | None, Header(max_length=1000)]
IfRange = Annotated[str | None, Header(max_length=200)]
Redirect = Annotated[
    bool, Query(description="false: the service sends the file itself, even if the store could send it (no 307).")
]


@router.get("/artifacts", responses=answers(404, 422))
async def list_artifacts(snapshot: SnapshotDep) -> ArtifactList:
    """List every result file with its size and SHA-256. Get each at /jobs/{job_id}/artifacts/{name}."""
    return ArtifactList(artifacts=_published(snapshot))


@router.get("/artifacts/{name:path}", response_class=Response, responses=_file("*/*"))
async def get_artifact(
    snapshot: SnapshotDep,
    parts: PartsDep,
    name: Annotated[str, Path(max_length=500)],
    wanted: RangeHeader = None,
    if_none_match: IfNoneMatch = None,
    if_range: IfRange = None,
    redirect: Redirect = True,
) -> Response:
    """Get a result file by its name in the list."""
    return await _send(parts, snapshot, name, wanted, if_none_match, if_range, redirect)


@router.get("/renders/{name:path}", response_class=Response, responses=_file("image/png"))
async def get_render(
    snapshot: SnapshotDep,
    parts: PartsDep,
    name: Annotated[str, Path(max_length=500, examples=["test/0001.png"])],
    wanted: RangeHeader = None,
    if_none_match: IfNoneMatch = None,
    if_range: IfRange = None,
) -> Response:
    """Get a picture of a test view."""
    return await _send(parts, snapshot, f"renders/{name}", wanted, if_none_match, if_range)


@router.get(
    "/log.txt",
    response_class=Response,
    responses={200: {"description": "The log.", "content": {"text/plain": {}}}, **answers(404, 422)},
)
async def get_log(snapshot: SnapshotDep, parts: PartsDep) -> Response:
    """Get the log of the last attempt, even while it runs."""
    data = await _from_last_attempt(parts, snapshot, "log.txt")
    return Response(data, media_type="text/plain; charset=utf-8", headers={"Cache-Control": "no-cache"})


@router.get(
    "/previews/{name}.webp",
    response_class=Response,
    responses={
        200: {"description": "A picture.", "content": {"image/webp": {}}},
        304: {"description": "The content is unchanged since the given ETag."},
        **answers(404, 422),
    },
)
async def get_preview(
    snapshot: SnapshotDep,
    parts: PartsDep,
    name: Annotated[str, Path(pattern="^[a-z_]{1,40}$", examples=["render"])],
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Get a preview of a view: `render`, `normals`, `transmitted` or `reflected`, refreshed during training.

    `photographs` and `masks` are the sheets that `GET .../photographs` describes.
    """
    return _tagged(await _from_last_attempt(parts, snapshot, f"previews/{name}.webp"), "image/webp", if_none_match)


@router.get(
    "/photographs",
    response_model=CheckedPhotographs,
    responses={304: {"description": "The content is unchanged since the given ETag."}, **answers(404, 422)},
)
async def get_photographs(snapshot: SnapshotDep, parts: PartsDep, if_none_match: IfNoneMatch = None) -> Response:
    """Get the checked photographs with their cameras. `previews/photographs` has small pictures of them."""
    data = await _from_last_attempt(parts, snapshot, "previews/photographs.json")
    checked = CheckedPhotographs.model_validate_json(data).model_dump_json().encode()
    return _tagged(checked, "application/json", if_none_match)


def _add_single(file: str, kind: str) -> None:
    """Add a separate route for a file that people request by name."""

    async def get_file(
        snapshot: SnapshotDep,
        parts: PartsDep,
        wanted: RangeHeader = None,
        if_none_match: IfNoneMatch = None,
        if_range: IfRange = None,
    ) -> Response:
        return await _send(parts, snapshot, file, wanted, if_none_match, if_range)

    operation = "get_" + file.replace(".", "_")
    router.add_api_route(
        f"/{file}",
        get_file,
        response_class=Response,
        responses=_file(kind),
        operation_id=operation,
        name=operation,
        description=f"The result file {file}.",
    )


for _name, _kind in SINGLE.items():
    _add_single(_name, _kind)


async def _send(
    parts: Parts,
    snapshot: Snapshot,
    name: str,
    wanted: str | None,
    if_none_match: str | None,
    if_range: str | None,
    redirect: bool = True,
) -> Response:
    artifact = _find(snapshot, name)
    assert snapshot.outcome is not None and snapshot.outcome.attempt is not None
    key = attempt_path(snapshot.state.record.id, snapshot.outcome.attempt, artifact.name)
    etag = f'"{artifact.sha256}"'
    headers = {"ETag": etag, "Accept-Ranges": "bytes", "Cache-Control": "private, no-cache"}
    if if_none_match is not None and (etag in if_none_match or if_none_match.strip() == "*"):
        return Response(status_code=304, headers=headers)
    if redirect and parts.settings.signed_urls:
        address = await run_in_threadpool(parts.jobs.store.signed_url, key)
        if address is not None:
            return RedirectResponse(address, 307)
    span = None if if_range is not None and if_range != etag else parse_range(wanted, artifact.size)
    start, end = span or (0, artifact.size)
    headers["Content-Length"] = str(end - start)
    if artifact.content_type.startswith("text/html"):
        headers["Content-Security-Policy"] = REPORT_POLICY
    if span is not None:
        headers["Content-Range"] = f"bytes {start}-{end - 1}/{artifact.size}"
    body = parts.jobs.store.stream(key, start, end) if end > start else _nothing()
    return StreamingResponse(body, 200 if span is None else 206, headers, artifact.content_type)


def _published(snapshot: Snapshot) -> list[Artifact]:
    outcome = snapshot.outcome
    if outcome is None or outcome.status is not JobStatus.SUCCEEDED:
        raise Problem(
            404, "no_results", f"job {snapshot.view.id} is {snapshot.view.status}; only succeeded jobs have results"
        )
    return outcome.artifacts


def _find(snapshot: Snapshot, name: str) -> Artifact:
    held = {artifact.name: artifact for artifact in _published(snapshot)}
    for candidate in ALIASES.get(name, (name,)):
        if candidate in held:
            return held[candidate]
    raise Problem(404, "artifact_unknown", f"the job has no file {name!r}; GET .../artifacts lists its files")


async def _from_last_attempt(parts: Parts, snapshot: Snapshot, name: str) -> bytes:
    job = snapshot.state.record.id

    def read() -> bytes | None:
        for attempt in sorted(parts.jobs.attempts(job), reverse=True):
            if (data := parts.jobs.store.read(attempt_path(job, attempt, name))) is not None:
                return data
        return None

    data = await run_in_threadpool(read)
    if data is None:
        raise Problem(404, "not_yet", f"{name} does not exist yet; job {job} is {snapshot.view.status}")
    return data


def _tagged(data: bytes, kind: str, if_none_match: str | None) -> Response:
    """Return the content with an ETag, or 304 if the caller already has this content."""
    headers = {"ETag": f'"{hashlib.sha256(data).hexdigest()[:32]}"', "Cache-Control": "no-cache"}
    if if_none_match is not None and headers["ETag"] in if_none_match:
        return Response(status_code=304, headers=headers)
    return Response(data, media_type=kind, headers=headers)


async def _nothing() -> AsyncIterator[bytes]:
    return
    yield b""
