"""Recovery of lost jobs.

A job is lost if its worker died, if its place in the queue vanished with Redis, or if its service was killed between
two steps of a submit. Every worker and every service runs the recovery. A lock in Redis admits one at a time.
"""

from __future__ import annotations

import time

from redis import Redis

from service.contract.jobs import Jobs
from service.contract.live import Live
from service.contract.queue import JobQueue, queue_for

PERIOD = 3.0  # seconds between two checks
# A round is lost if two checks, this many seconds apart, find it without a worker and without a place in the queue. A
# single check may see a round that is just being dequeued, or whose worker has not yet returned to a restarted Redis.
GRACE = 6.0
ABANDONED_SUBMIT = 3600.0
SWEEP_PERIOD = 600.0


class Recovery:
    """Repeated checks of the open rounds."""

    def __init__(self, jobs: Jobs, live: Live, queue: JobQueue) -> None:
        self.jobs, self.live, self.queue = jobs, live, queue
        self._redis: Redis = live.redis

    def look(self) -> None:
        """Recover lost rounds, unless another process has just checked. Raises StoreError and redis.RedisError."""
        if not self._redis.set("mgsr:recovery", 1, nx=True, px=round(PERIOD * 900)):
            return
        waiting = self.queue.waiting()
        for job, number, age in list(self.jobs.open_rounds()):
            self._mend(job, number, age, waiting)
        if self._redis.set("mgsr:sweep", 1, nx=True, ex=round(SWEEP_PERIOD)):
            self.jobs.sweep_uploads()

    def _mend(self, job: str, number: int, age: float, waiting: dict[tuple[str, int], int]) -> None:
        if self.live.leased(job):
            return
        cancelling = self.live.cancel_asked(job, number) or self.jobs.cancel_asked(job, number)
        if (job, number) in waiting and not cancelling:
            return
        if not self._missing_for_long(job, number):
            return
        if self.jobs.outcome(job, number) is not None:
            self.jobs.store.delete(f"open/{job}.{number}")
        elif cancelling:
            self.jobs.cancel_now(job, number)
        else:
            self._queue_again(job, number, age)

    def _missing_for_long(self, job: str, number: int) -> bool:
        key = f"mgsr:missing:{job}.{number}"
        first = self._redis.set(key, time.time(), nx=True, ex=60, get=True)
        if first is None or time.time() - float(first) < GRACE:
            return False
        self._redis.delete(key)
        return True

    def _queue_again(self, job: str, number: int, age: float) -> None:
        record = self.jobs.record(job)
        if record is None:
            if age > ABANDONED_SUBMIT:
                self.jobs.store.delete(f"open/{job}.{number}")
            return
        if number == 0:
            self.jobs.index(record)
        self.queue.put(job, number, queue_for(record.options), first=True)
