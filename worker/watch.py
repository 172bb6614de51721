"""Checks, a few times a second, for a reason to stop a running attempt."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from redis import RedisError

from service.contract.live import Live

CANCEL_PERIOD = 0.5  # seconds between two checks for a cancel
MEASURE_PERIOD = 0.25
DISK_PERIOD = 1.0


class Reason(StrEnum):
    """A reason to stop an attempt from outside."""

    CANCELLED = "cancelled"
    DEADLINE = "deadline_exceeded"
    SHUTDOWN = "shutdown"
    LEASE_LOST = "lease_lost"
    DISK_FULL = "disk_full"
    MEMORY = "out_of_memory"


class Watch:
    """The check of all reasons that can stop an attempt. `look` keeps returning the first reason found."""

    def __init__(
        self,
        live: Live,
        job: str,
        number: int,
        deadline: float,
        scratch: Path,
        min_free_disk: int,
        memory_limit: int,
        outside: Callable[[], Reason | None],
    ) -> None:
        """Start the watch. deadline: seconds from now. outside: reports reasons that other classes know."""
        self._live, self._job, self._number = live, job, number
        self._ends = time.monotonic() + deadline
        self._scratch, self._min_free_disk, self._memory_limit = scratch, min_free_disk, memory_limit
        self._outside = outside
        self._next = {"cancel": 0.0, "disk": 0.0, "memory": 0.0}
        self.reason: Reason | None = None

    def look(self, memory: Callable[[], int] | None = None) -> Reason | None:
        """Return the reason to stop, or None. memory: returns the memory of the job process in bytes."""
        if self.reason is None:
            self.reason = self._outside() or self._find(memory)
        return self.reason

    def _find(self, memory: Callable[[], int] | None) -> Reason | None:
        if self._due("cancel", CANCEL_PERIOD) and self._cancel_asked():
            return Reason.CANCELLED
        if time.monotonic() > self._ends:
            return Reason.DEADLINE
        if memory is not None and self._due("memory", MEASURE_PERIOD) and memory() > self._memory_limit:
            return Reason.MEMORY
        if self._due("disk", DISK_PERIOD) and shutil.disk_usage(self._scratch).free < self._min_free_disk:
            return Reason.DISK_FULL
        return None

    def _cancel_asked(self) -> bool:
        try:
            return self._live.cancel_asked(self._job, self._number)
        except RedisError:
            return False  # the next check asks again

    def _due(self, what: str, period: float) -> bool:
        now = time.monotonic()
        if now < self._next[what]:
            return False
        self._next[what] = now + period
        return True
