"""The removal of expired data: abandoned uploads, and jobs past their retention."""

from __future__ import annotations

from service.contract.jobs import Jobs
from service.contract.live import Live
from service.contract.resumable import ResumableUploads
from service.contract.retention import Retention

PERIOD = 600.0  # seconds between two checks, for all services together


class Housekeeping:
    """Repeated removal of expired data. retention: seconds from a job's end to its removal; None keeps all jobs."""

    def __init__(self, jobs: Jobs, live: Live, uploads: ResumableUploads, retention: float | None) -> None:
        self._live, self._uploads = live, uploads
        self._retention = None if retention is None else Retention(jobs, retention)

    def look(self) -> None:
        """Remove expired data, unless another service has just checked. Raises StoreError and redis.RedisError."""
        if not self._live.redis.set("mgsr:housekeeping", 1, nx=True, ex=round(PERIOD)):
            return
        self._uploads.sweep()
        if self._retention is not None:
            self._retention.remove_due(self._live)
