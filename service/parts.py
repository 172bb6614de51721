"""The objects that all routes share, and the dependencies that identify the caller and its jobs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, cast

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from redis.asyncio import Redis as AsyncRedis

from service.contract.jobs import Jobs
from service.contract.live import Live
from service.contract.queue import JobQueue
from service.contract.resumable import ResumableUploads
from service.contract.settings import Settings
from service.events import EventHub
from service.keys import Keys
from service.metrics import Metrics
from service.problems import Problem
from service.snapshots import Snapshot, Snapshots

# The owner of all jobs of a service without keys.
LOCAL = "local"


@dataclass(frozen=True)
class Parts:
    """The app's shared objects. redis: the asynchronous client."""

    settings: Settings
    jobs: Jobs
    uploads: ResumableUploads
    keys: Keys
    live: Live
    queue: JobQueue
    redis: AsyncRedis
    snapshots: Snapshots
    hub: EventHub
    metrics: Metrics


# All dependencies are asynchronous: FastAPI calls others in a thread, which costs more than the rest of a request.
async def _parts(request: Request) -> Parts:
    return cast(Parts, request.app.state.parts)


PartsDep = Annotated[Parts, Depends(_parts)]
_bearer = HTTPBearer(
    auto_error=False, description="A key created with `mgsr keys create`. A service without keys needs none."
)


async def _owner(parts: PartsDep, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]) -> str:
    needed = parts.keys.needed_cached
    if needed is None:
        needed = await run_in_threadpool(parts.keys.needed)
    if not needed:
        return LOCAL
    token = credentials.credentials if credentials is not None else ""
    key = parts.keys.cached(token) or await run_in_threadpool(parts.keys.find, token)
    if key is None:
        raise Problem(
            401,
            "key_unknown",
            "expected the header `Authorization: Bearer KEY` with a key created by `mgsr keys create`",
            {"WWW-Authenticate": "Bearer"},
        )
    return key.id


OwnerDep = Annotated[str, Depends(_owner)]


async def _own_job(job_id: str, owner: OwnerDep, parts: PartsDep) -> Snapshot:
    snapshot = await parts.snapshots.get(job_id)
    # Another owner's job gets the same answer as an unknown job, so that ids stay private.
    if snapshot is None or snapshot.owner != owner:
        raise Problem(404, "job_unknown", f"you have no job {job_id[:64]!r}; GET /jobs lists your jobs")
    return snapshot


SnapshotDep = Annotated[Snapshot, Depends(_own_job)]
