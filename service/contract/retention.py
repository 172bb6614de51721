"""The retention of jobs after their end. Without a retention, they stay until their owner removes them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime, timedelta

from redis import RedisError

from service.contract.jobs import Jobs, JobState
from service.contract.live import Live
from service.contract.records import now


def expiry(state: JobState, seconds: float | None) -> datetime | None:
    """Return when a job is deleted, or None for an open or pinned job, and without a retention."""
    if seconds is None or state.outcome is None or state.pinned:
        return None
    return state.outcome.finished + timedelta(seconds=seconds)


class Retention:
    """The removal of jobs a certain time after their end."""

    def __init__(self, jobs: Jobs, seconds: float) -> None:
        self._jobs, self._seconds = jobs, seconds

    def due(self) -> Iterator[JobState]:
        """Yield the jobs whose retention is over. Raises StoreError."""
        for job in self._jobs.created_before(now() - timedelta(seconds=self._seconds)):
            state = self._jobs.state(job)
            if state is not None and (end := expiry(state, self._seconds)) is not None and end < now():
                yield state

    def remove_due(self, live: Live) -> None:
        """Remove the jobs whose retention is over, with their files. Raises StoreError."""
        for state in self.due():
            self._jobs.remove(state.record)
            with suppress(RedisError):  # the state expires by itself
                live.forget(state.record.id)
