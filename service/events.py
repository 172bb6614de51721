"""Server-sent events of jobs. Each watched job has one reader, for any number of clients."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

from redis import RedisError
from redis.asyncio import Redis as AsyncRedis

from service.contract.live import events_key
from service.snapshots import Snapshot, Snapshots

BLOCK_MS = 2000
# A watcher that is this many events behind is disconnected. It returns with Last-Event-ID.
BEHIND = 500
LOOK_SECONDS = 3.0
KEEP_ALIVE_SECONDS = 15.0
EVENT_ID = re.compile(r"\d{1,20}-\d{1,20}")


@dataclass(frozen=True)
class ServerEvent:
    """An entry of a job's stream. id: the id in Redis, which increases with time."""

    id: str
    kind: str
    data: str

    def encode(self) -> bytes:
        """Encode the event as a server-sent event."""
        return f"id: {self.id}\nevent: {self.kind}\ndata: {self.data}\n\n".encode()

    @property
    def order(self) -> tuple[int, int]:
        """Return the key by which events are ordered."""
        return event_order(self.id)


@dataclass
class _Watched:
    """A job's watchers, and the task that reads for them. ready: set once the task knows where to start reading."""

    watchers: set[asyncio.Queue[ServerEvent | None]] = field(default_factory=set)
    reader: asyncio.Task[None] | None = None
    ready: asyncio.Event = field(default_factory=asyncio.Event)


class EventHub:
    """The distribution of each job's events to all its watchers."""

    def __init__(self, redis: AsyncRedis, snapshots: Snapshots) -> None:
        self._redis, self._snapshots = redis, snapshots
        self._jobs: dict[str, _Watched] = {}

    async def follow(self, snapshot: Snapshot, after: str | None) -> AsyncIterator[bytes]:
        """Yield the job's current state, then its events until it ends.

        after: the id of the last event that the client knows; None starts with new events.
        """
        job = snapshot.state.record.id
        queue: asyncio.Queue[ServerEvent | None] = asyncio.Queue(BEHIND)
        watched = self._join(job, queue)
        try:
            await watched.ready.wait()  # later events are in the queue, earlier ones in the stream
            snapshot = await self._snapshots.read(job) or snapshot  # the given one may miss earlier events
            yield b"retry: 2000\n\n" + _job_event(snapshot)
            last = (0, 0)
            for event in await self._missed(job, after):
                last = event.order
                yield event.encode()
            if snapshot.final:
                return
            async for chunk in self._live(job, queue, last):
                yield chunk
        finally:
            self._leave(job, queue)

    async def _live(
        self, job: str, queue: asyncio.Queue[ServerEvent | None], last: tuple[int, int]
    ) -> AsyncIterator[bytes]:
        """Yield events as they arrive.

        The job itself is read too, because the event of its end may be lost with Redis.
        """
        quiet = 0.0
        while True:
            try:
                event = await asyncio.wait_for(queue.get(), LOOK_SECONDS)
            except TimeoutError:
                quiet += LOOK_SECONDS
                if quiet >= KEEP_ALIVE_SECONDS:
                    quiet = 0.0
                    yield b": still here\n\n"
                event = ServerEvent("", "look", "")
            if event is None:
                return
            if event.kind == "progress" and event.order > last:
                quiet = 0.0
                yield event.encode()
            if event.kind != "progress":
                if event.kind == "status":
                    self._snapshots.forget(job)
                now = await self._snapshots.get(job)
                if now is None or event.kind == "status":
                    yield event.encode() if event.order > last else b""
                if now is None or now.final:
                    yield b"" if now is None else _job_event(now)
                    return

    async def _missed(self, job: str, after: str | None) -> list[ServerEvent]:
        if after is None:
            return []
        try:
            entries = await self._redis.xrange(events_key(job), min=f"({after}")
        except RedisError:
            return []
        return [_event(entry) for entry in entries or []]

    def _join(self, job: str, queue: asyncio.Queue[ServerEvent | None]) -> _Watched:
        watched = self._jobs.setdefault(job, _Watched())
        watched.watchers.add(queue)
        if watched.reader is None:
            watched.reader = asyncio.create_task(self._read(job, watched))
        return watched

    def _leave(self, job: str, queue: asyncio.Queue[ServerEvent | None]) -> None:
        watched = self._jobs[job]
        watched.watchers.discard(queue)
        if not watched.watchers and watched.reader is not None:
            watched.reader.cancel()
            del self._jobs[job]

    async def _newest(self, job: str) -> str:
        """Return the id of the newest event. XREAD's own `$` would lose events between two calls."""
        try:
            entries = await self._redis.xrevrange(events_key(job), count=1)
        except RedisError:
            return "$"
        return _event(entries[0]).id if entries else "0-0"

    async def _read(self, job: str, watched: _Watched) -> None:
        last = await self._newest(job)
        watched.ready.set()
        while True:
            try:
                found = await self._redis.xread({events_key(job): last}, block=BLOCK_MS)
            except RedisError:
                await asyncio.sleep(1.0)
                continue
            for entry in _entries(found):
                event = _event(entry)
                last = event.id
                _hand_out(event, watched)


def event_order(text: str) -> tuple[int, int]:
    """Return an event's id as two numbers; (0, 0) for text that is not an id."""
    if not EVENT_ID.fullmatch(text):
        return (0, 0)
    first, _, second = text.partition("-")
    return int(first), int(second)


def _entries(found: Any) -> list[Any]:
    """Return the entries of the one stream that was read."""
    return [entry for _, entries in found or [] for entry in entries]


def _hand_out(event: ServerEvent, watched: _Watched) -> None:
    for queue in watched.watchers:
        if queue.full():
            while not queue.empty():
                queue.get_nowait()
            queue.put_nowait(None)
        else:
            queue.put_nowait(event)


def _event(entry: Any) -> ServerEvent:
    number, fields = entry
    return ServerEvent(number.decode(), fields[b"event"].decode(), fields[b"data"].decode())


def _job_event(snapshot: Snapshot) -> bytes:
    return b"event: job\ndata: " + snapshot.body + b"\n\n"
