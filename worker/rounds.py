"""The work on rounds of jobs: claim a round, make an attempt, and file its outcome."""

from __future__ import annotations

import logging
import os
import secrets
import socket
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Any

from redis import Redis, RedisError

from service.contract.errors import StoreError
from service.contract.jobs import Jobs, attempt_path
from service.contract.live import Live
from service.contract.queue import JobQueue, queue_for
from service.contract.records import Failure, JobRecord, JobStatus, Outcome, now
from service.contract.settings import Settings
from service.contract.store import Store
from worker.attempt import FINAL_CODES, Attempt, Interrupted, WorkerContext
from worker.lease import LeaseKeeper
from worker.tracing import RoundTrace

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

log = logging.getLogger("mgsr.worker")

# The seconds for which failed requests during a round are repeated. Later checks repeat them anyway.
SHORT_PATIENCE = 5.0


class Rounds:
    """A worker's handling of the rounds that it takes from the queue."""

    def __init__(
        self,
        settings: Settings,
        redis: Redis,
        stopping: Callable[[], bool],
        telemetry: TracerProvider | None = None,
    ) -> None:
        self._settings, self._telemetry = settings, telemetry
        self._stopping = stopping
        self.name = f"{socket.gethostname()}.{os.getpid()}.{secrets.token_hex(3)}"
        self.live = Live(redis)
        self.queue = JobQueue(redis)
        self.retrying_jobs = Jobs(Store(settings.store_url, settings.publish_patience))
        self.jobs = Jobs(Store(settings.store_url, SHORT_PATIENCE))

    def take(self, job: str, number: int, beat: Callable[[], None], waiting_since: datetime | None = None) -> None:
        """Work on a round, unless another worker does or it has ended. waiting_since: when it was queued.

        Errors of Redis or the store are logged. The round then stays open, and recovery puts it back into the queue.
        """
        holder = f"{self.name}.{secrets.token_hex(4)}"
        try:
            if not self.live.take_lease(job, holder, self._settings.lease):
                return
            with LeaseKeeper(self.live, job, holder, self._settings.lease) as lease:
                self._work(job, number, holder, lease, beat, waiting_since)
        except (StoreError, RedisError) as error:
            log.warning("job %s: another attempt will continue it: %s", job, error)

    def _work(
        self,
        job: str,
        number: int,
        holder: str,
        lease: LeaseKeeper,
        beat: Callable[[], None],
        waiting_since: datetime | None,
    ) -> None:
        record = self.retrying_jobs.record(job)
        if record is None or self.retrying_jobs.outcome(job, number) is not None:
            self.retrying_jobs.store.delete(f"open/{job}.{number}")
            return
        if self.live.cancel_asked(job, number) or self.retrying_jobs.cancel_asked(job, number):
            self._end(record, number, Outcome(status=JobStatus.CANCELLED, attempt=None, finished=now()))
            return
        if (lost := self.retrying_jobs.lost_attempts(job, number)) >= self._settings.max_attempts:
            self._end(record, number, _given_up(lost))
            return
        attempt = self.retrying_jobs.begin_attempt(job, number, holder)
        log.info("job %s: attempt %d begins", job, attempt)
        try:
            with RoundTrace(self._telemetry, record, number, waiting_since) as trace:
                context = WorkerContext(
                    self._settings, self.retrying_jobs, self.jobs, self.live, self._stopping, beat, trace.step
                )
                outcome = Attempt(context, record, number, attempt, lease).run()
                trace.ended(attempt, outcome)
            self._end(record, number, outcome)
        except Interrupted as stop:
            log.info("job %s: attempt %d interrupted", job, attempt)
            if not stop.lost:
                self.jobs.end_attempt(job, attempt)
            if not lease.lost:
                self.queue.put(job, number, queue_for(record.options), first=True)

    def _end(self, record: JobRecord, number: int, outcome: Outcome) -> None:
        """File the outcome, tell listeners, and delete what is no longer needed."""
        won = self.retrying_jobs.finish(record.id, number, outcome)
        log.info("job %s: %s%s", record.id, outcome.status, "" if won else ", but another attempt had finished first")
        if not won:
            return
        self._tell(record.id, {"status": outcome.status, "round": number})
        if outcome.status is JobStatus.SUCCEEDED:
            for attempt in self.retrying_jobs.attempts(record.id):
                self.retrying_jobs.store.delete(attempt_path(record.id, attempt, "checkpoint"))
        elif outcome.error is not None and outcome.error.code in FINAL_CODES:
            self.retrying_jobs.archives.delete(record.archive)

    def _tell(self, job: str, data: dict[str, Any]) -> None:
        try:
            self.live.publish(job, "status", data)
        except RedisError:
            return  # listeners also read the store periodically


def _given_up(lost: int) -> Outcome:
    failure = Failure(
        code="worker_lost",
        message=f"{lost} attempts ended because their worker or process was killed; check the workers, then retry",
        retryable=True,
    )
    return Outcome(status=JobStatus.FAILED, attempt=None, finished=now(), error=failure)
