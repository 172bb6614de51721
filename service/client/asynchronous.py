"""The client for programs that use asyncio: the same methods as coroutines. Each call runs in a thread."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

from service.client.api import Client, Job, Progress, ignore


class AsyncClient:
    """A client of one service. Use it in `async with`. It raises the errors of `Client`.

    Progress callbacks run in the thread of the event loop.


    unfinished: see `Client`.
    """

    def __init__(self, server: str, key: str | None = None, unfinished: Path | None = None) -> None:
        self._client = Client(server, key, unfinished)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *trouble: object) -> None:
        await asyncio.to_thread(self._client.close)

    async def submit(self, scene: Path, options: Mapping[str, Any], sent: Progress = ignore) -> Job:
        """Send a folder or an archive of photographs, or a video, and return the job."""
        return await asyncio.to_thread(self._client.submit, scene, options, _in_loop(sent))

    async def rerun(self, job: str, options: Mapping[str, Any]) -> Job:
        """Submit the archive of an earlier job again with these options, and return the new job."""
        return await asyncio.to_thread(self._client.rerun, job, options)

    async def jobs(self, limit: int = 50) -> list[Job]:
        """Return your jobs, the newest first."""
        return await asyncio.to_thread(self._client.jobs, limit)

    async def job(self, job: str) -> Job:
        """Return the job's current state."""
        return await asyncio.to_thread(self._client.job, job)

    async def pin(self, job: str, pinned: bool = True) -> Job:
        """Pin a job, so that it outlasts the service's retention, or unpin it."""
        return await asyncio.to_thread(self._client.pin, job, pinned)

    async def cancel(self, job: str) -> Job:
        """Ask the service to cancel the job."""
        return await asyncio.to_thread(self._client.cancel, job)

    async def follow(self, job: str) -> AsyncIterator[Job]:
        """Yield the job's changed fields, and last the whole job. Resumes if the connection breaks."""
        states = self._client.follow(job)
        while (state := await asyncio.to_thread(next, states, None)) is not None:
            yield state

    async def fetch(self, job: str, out: Path, got: Progress = ignore) -> list[Path]:
        """Fetch every result of a job into a folder, and return the files."""
        return await asyncio.to_thread(self._client.fetch, job, out, _in_loop(got))


def _in_loop(tell: Progress) -> Callable[[int, int], None]:
    """Return a function for other threads that calls a progress callback in the event loop."""
    loop = asyncio.get_running_loop()

    def report(done: int, total: int) -> None:
        loop.call_soon_threadsafe(tell, done, total)

    return report
