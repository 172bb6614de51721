"""The worker process: RQ takes rounds from the queue, and worker/rounds.py does the work."""

from __future__ import annotations

import logging
import signal
import threading
import time
from contextlib import suppress
from contextvars import ContextVar
from types import FrameType
from typing import TYPE_CHECKING, Any

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
from service.contract.telemetry import open_telemetry
from worker.post import Post
from worker.rounds import Rounds
from worker.scratch import sweep

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

log = logging.getLogger("mgsr.worker")

SWEEP_PERIOD = 30.0
WORKER_TTL = 60

# The worker that runs this thread's task. RQ calls tasks by name, with only the arguments from the queue.
current_worker: ContextVar[MgsrWorker] = ContextVar("current_worker")


class NoPenalty(BaseDeathPenalty):
    """RQ's timeout, switched off: the attempt watches the job's own deadline."""

    def setup_death_penalty(self) -> None:
        """Do nothing instead of setting an alarm."""

    def cancel_death_penalty(self) -> None:
        """Do nothing, since there is no alarm."""


class StopSignals:
    """The signal handlers of SIGTERM and SIGINT, and whether one of them has come.

    A running attempt then writes a checkpoint and returns to the queue, and an idle worker ends. The object lives as
    long as the process, unlike RQ's handlers, which belong to a worker; each loss of Redis needs a new worker.
    """

    def __init__(self) -> None:
        self.asked = self.busy = False

    def install_handlers(self) -> None:
        """Install the signal handlers for this process."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def __call__(self) -> bool:
        return self.asked

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if not self.busy:
            raise StopRequested


class MgsrWorker(SimpleWorker):
    """An RQ worker that runs tasks in its own process. Tasks only supervise; `Attempt` spawns the job as a process."""

    death_penalty_class = NoPenalty
    max_connection_wait_time = 2.0
    log_result_lifespan = False

    def __init__(
        self, queues: list[str], settings: Settings, stop: StopSignals, telemetry: TracerProvider | None = None
    ) -> None:
        url = settings.need_redis()
        # There are two clients: RQ raises its client's time-out to wait for jobs, and leases must not wait that long.
        connection = connect(url)
        self.rounds = Rounds(settings, connect(url), stop, telemetry)
        self._stop = stop
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
        self._stop.busy = True
        try:
            super().execute_job(job, queue)
        finally:
            self._stop.busy = False
            current_worker.reset(token)
        if self._stop.asked:
            raise StopRequested

    def _install_signal_handlers(self) -> None:
        """Do nothing, since StopSignals has the handlers."""

    def handle_exception(self, job: Job, *exc_info: Any) -> None:
        """Log an unexpected error. Recovery puts the round back into the queue."""
        log.error("job %s: the attempt failed unexpectedly", job.id, exc_info=exc_info)


def work(queues: list[str], settings: Settings) -> None:
    """Take jobs until SIGTERM or SIGINT, across restarts of Redis."""
    for chore in (_keep_house, _send_post):
        threading.Thread(target=chore, args=(settings,), daemon=True, name=chore.__name__).start()
    stop, telemetry = StopSignals(), open_telemetry("mgsr-worker")
    with suppress(StopRequested):
        stop.install_handlers()
        while not stop.asked:
            try:
                MgsrWorker(queues, settings, stop, telemetry).work(logging_level="WARNING")
            except RedisError as error:
                log.warning("Redis does not answer and is tried again: %s", error)
            if not stop.asked:
                time.sleep(1.0)


def _keep_house(settings: Settings) -> None:
    """Recover lost jobs, and remove the scratch folders of killed workers from this machine's disk."""
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
            log.warning("recovery failed and will be retried: %s", error)
        time.sleep(PERIOD)


def _send_post(settings: Settings) -> None:
    """Deliver webhooks. This runs in a thread of its own, which slow receivers may delay."""
    rounds = Rounds(settings, connect(settings.need_redis()), lambda: False)
    post = Post(rounds.jobs, rounds.live.redis, settings.webhook_private)
    while True:
        try:
            post.look()
        except (RedisError, StoreError) as error:
            log.warning("webhooks failed and will be retried: %s", error)
        time.sleep(PERIOD)
