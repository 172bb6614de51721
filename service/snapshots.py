"""The current states of jobs. Simultaneous requests for a job share one read.

Three hundred clients that poll a job cause one read of store and Redis every half second.
"""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import json
import re
import time
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi.concurrency import run_in_threadpool
from redis import RedisError
from redis.asyncio import Redis as AsyncRedis

from service.contract.jobs import Jobs, JobState
from service.contract.live import cancel_key, lease_key, progress_key
from service.contract.queue import JobQueue
from service.contract.records import Outcome
from service.views import JobView, job_view

FRESH_SECONDS = 0.4
# A job that has ended changes only by a retry. A retry through another service becomes visible after this time.
FRESH_FINAL_SECONDS = 2.0
# The longest time for which the old state is used while the job is read again.
READING_SECONDS = 0.5
KEPT = 5000
_ID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True)
class Snapshot:
    """The state of a job at one time. body: the view as JSON."""

    owner: str
    state: JobState
    view: JobView
    body: bytes
    etag: str
    read_at: float

    @property
    def outcome(self) -> Outcome | None:
        """Return the outcome of the last round, or None while it has not ended."""
        return self.state.outcome

    @property
    def final(self) -> bool:
        """Return whether the job has ended."""
        return self.state.outcome is not None


class Snapshots:
    """The cached states of recently requested jobs."""

    def __init__(self, jobs: Jobs, queue: JobQueue, redis: AsyncRedis, retention: float | None) -> None:
        """Begin with an empty cache. retention: seconds for which jobs are kept after their end; None for ever."""
        self._jobs, self._queue, self._redis, self._retention = jobs, queue, redis, retention
        self._kept: dict[str, Snapshot] = {}
        self._reading: dict[str, asyncio.Task[Snapshot | None]] = {}
        self._changed: dict[str, float] = {}
        self._waiting: tuple[float, dict[tuple[str, int], int]] = (float("-inf"), {})

    async def get(self, job: str) -> Snapshot | None:
        """Return a state of the job, or None for an unknown id.

        It is at most half a second old, or a second if the store is slow.
        """
        if not _ID.fullmatch(job):
            return None
        return self.fresh(job) or await self.read(job)

    def fresh(self, job: str) -> Snapshot | None:
        """Return the job if it was read recently, else None.

        While it is being read again, a slightly older state is enough.
        """
        kept = self._kept.get(job)
        if kept is None:
            return None
        limit = FRESH_FINAL_SECONDS if kept.final else FRESH_SECONDS
        if job in self._reading:
            limit += READING_SECONDS
        return kept if time.monotonic() - kept.read_at < limit else None

    async def read(self, job: str) -> Snapshot | None:
        """Read the current state of the job, or None for an unknown id. Simultaneous calls share one read."""
        task = self._reading.get(job)
        if task is None:
            task = asyncio.create_task(self._read(job))
            self._reading[job] = task
            task.add_done_callback(partial(self._read_done, job))
        return await asyncio.shield(task)

    def _read_done(self, job: str, task: asyncio.Task[Snapshot | None]) -> None:
        if self._reading.get(job) is task:
            del self._reading[job]

    def forget(self, job: str) -> None:
        """Drop the cached job after this service has changed it, so that the next call reads it again."""
        self._kept.pop(job, None)
        self._reading.pop(job, None)
        self._waiting = (float("-inf"), {})
        self._changed[job] = time.monotonic()
        while len(self._changed) > KEPT:
            self._changed.pop(next(iter(self._changed)))

    async def _read(self, job: str) -> Snapshot | None:
        started_at = time.monotonic()
        state = await run_in_threadpool(self._jobs.state, job)
        if state is None:
            return None
        view = await self._view(state)
        body = view.model_dump_json().encode()
        etag = f'"{hashlib.sha256(body).hexdigest()[:32]}"'
        snapshot = Snapshot(state.record.owner, state, view, body, etag, started_at)
        if self._changed.get(job, 0.0) <= started_at:  # a state from before a change is not kept
            self._kept[job] = snapshot
        while len(self._kept) > KEPT:
            self._kept.pop(next(iter(self._kept)))
        return snapshot

    async def _view(self, state: JobState) -> JobView:
        job = state.record.id
        try:
            leased, progress, cancelling = await self._redis.mget(
                lease_key(job), progress_key(job), cancel_key(job, state.round)
            )
            if cancelling is not None and state.outcome is None:
                state = dataclasses.replace(state, cancelling=True)
            place = None
            if state.outcome is None and leased is None:
                place = (await self._waiting_places()).get((job, state.round))
            return job_view(state, leased is not None, json.loads(progress or "{}"), place, self._retention)
        except RedisError:
            return await self._view_without_redis(state)

    async def _view_without_redis(self, state: JobState) -> JobView:
        """Return the job's view from its last known state, or from the starts of attempts in the store."""
        before = self._kept.get(state.record.id)
        known: dict[str, Any] = {}
        if before is not None and before.state.round == state.round:
            known = before.view.model_dump(exclude_none=True) | {"text": before.view.message}
        started = await run_in_threadpool(self._jobs.attempts, state.record.id)
        return job_view(
            state, any(start.round == state.round for start in started.values()), known, None, self._retention
        )

    async def _waiting_places(self) -> dict[tuple[str, int], int]:
        read_at, places = self._waiting
        if time.monotonic() - read_at > FRESH_SECONDS:
            places = await run_in_threadpool(self._queue.waiting)
            self._waiting = (time.monotonic(), places)
        return places
