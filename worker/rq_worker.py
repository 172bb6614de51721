"""The worker process: RQ takes rounds from the queue, worker/rounds.py does the work."""

from __future__ import annotations

import logging
import threading
import time
from contextvars import ContextVar
from types import FrameType
from typing import Any

from redis import RedisError
from rq import Queue
from rq.exceptions import StopRequested
from rq.job import Job
from rq.serializers import JSONSerializer
from rq.timeouts import BaseDeathPenalty
from rq.worker import SimpleWorker

from service.contract.errors import StoreError
from service.contract.queue import connect, open_queue
from service.contract.recovery import PERIOD, Recovery
from service.contract.settings import Settings
from worker.rounds import Rounds
from worker.scratch import sweep

log = logging.getLogger("mgsr.worker")

SWEEP_PERIOD = 30.0
WORKER_TTL = 60

# The worker that runs this thread's task: RQ calls tasks by name, with the arguments from the queue alone.
current_worker: ContextVar[MgsrWorker] = ContextVar("current_worker")


class NoPenalty(BaseDeathPenalty):
    """RQ's alarm clock, switched off: the job's own deadline is watched by the attempt."""

    def setup_death_penalty(self) -> None:
        """Set no alarm."""

    def cancel_death_penalty(self) -> None:
        """There is none."""


class MgsrWorker(SimpleWorker):
    """Runs its tasks in its own process, which only supervises: the job itself is a process that `Attempt` spawns.

    SIGTERM and SIGINT have the running attempt write a checkpoint and go back into the queue.
    """

    death_penalty_class = NoPenalty
    max_connection_wait_time = 2.0
    log_result_lifespan = False

    def __init__(self, queues: list[str], settings: Settings) -> None:
        url = settings.need_redis()
        # Two clients: RQ raises the time-out of its own, so that it can wait for jobs; leases must not wait so long.
        connection = connect(url)
        self.rounds = Rounds(settings, connect(url), lambda: bool(self._stop_requested))
        self._busy = False
        super().__init__(
            [open_queue(name, connection) for name in queues],
            name=self.rounds.name,
            connection=connection,
            serializer=JSONSerializer,
            worker_ttl=WORKER_TTL,
            maintenance_interval=30,
            job_monitoring_interval=10,
        )

    def execute_job(self, job: Job, queue: Queue) -> None:
        """Run the task with this worker as its context."""
        token = current_worker.set(self)
        self._busy = True
        try:
            super().execute_job(job, queue)
        finally:
            self._busy = False
            current_worker.reset(token)

    def request_stop(self, signum: int, frame: FrameType | None) -> None:
        """End at once if idle, else have the running attempt end first. (RQ's own asks Redis, which may be away.)"""
        self._stop_requested = True
        if not self._busy:
            raise StopRequested

    def handle_exception(self, job: Job, *exc_info: Any) -> None:
        """Log what should not have happened; recovery puts the round back."""
        log.error("job %s: the attempt itself failed", job.id, exc_info=exc_info)


def work(queues: list[str], settings: Settings) -> None:
    """Take jobs until SIGTERM or SIGINT. Survives restarts of Redis."""
    threading.Thread(target=_keep_house, args=(settings,), daemon=True, name="house").start()
    while True:
        try:
            worker = MgsrWorker(queues, settings)
            worker.work(logging_level="WARNING")
            if worker._stop_requested:
                return
            time.sleep(1.0)
        except RedisError as error:
            log.warning("no answer from Redis, trying again: %s", error)
            time.sleep(1.0)
        except StopRequested:
            return


def _keep_house(settings: Settings) -> None:
    """Recover lost jobs, and remove what killed workers left on this machine's disk."""
    rounds = Rounds(settings, connect(settings.need_redis()), lambda: False)
    recovery = Recovery(rounds.jobs, rounds.live, rounds.queue)
    swept = float("-inf")
    while True:
        try:
            if time.monotonic() - swept > SWEEP_PERIOD:
                swept = time.monotonic()
                sweep(settings.scratch_folder)
            recovery.look()
        except (RedisError, StoreError, OSError) as error:
            log.warning("recovery: trying again: %s", error)
        time.sleep(PERIOD)
