"""The queue: RQ with its JSON serializer, and only ids as arguments. recovery.py restores lost entries."""

from __future__ import annotations

import secrets

from redis import Redis
from redis.backoff import ExponentialBackoff
from redis.retry import Retry
from rq import Queue, Worker
from rq.serializers import JSONSerializer

from service.contract.options import Device, JobOptions

CPU, GPU = "cpu", "gpu"
QUEUES = (GPU, CPU)
TASK = "worker.tasks.run_job"
ANSWER_SECONDS = 5.0


def connect(url: str) -> Redis:
    """Return a client with a time-out, so that it doesn't wait forever for a server that doesn't answer."""
    retry = Retry(ExponentialBackoff(cap=0.5, base=0.05), 2)
    return Redis.from_url(
        url, socket_timeout=ANSWER_SECONDS, socket_connect_timeout=2.0, health_check_interval=15, retry=retry
    )


def queue_for(options: JobOptions) -> str:
    """Return the name of a job's queue.

    Jobs that request a GPU wait for a worker with a GPU. Any worker can take the others.
    """
    return GPU if options.device is Device.CUDA else CPU


class JobQueue:
    """Rounds of jobs that wait for a worker. Its methods raise redis.RedisError if the server doesn't answer."""

    def __init__(self, redis: Redis) -> None:
        self._redis = redis
        self.queues = {name: open_queue(name, redis) for name in QUEUES}

    def put(self, job: str, number: int, queue: str, first: bool = False) -> None:
        """Append a round to the queue, or put it first if it has waited before.

        Leases ensure that only one worker processes a round, even if it is in the queue twice.
        """
        self.queues[queue].enqueue_call(
            TASK,
            args=(job, number),
            job_id=f"{job}-{number}-{secrets.token_hex(4)}",
            timeout=-1,  # the worker watches the job's own deadline
            result_ttl=0,
            failure_ttl=0,
            at_front=first,
        )

    def waiting(self) -> dict[tuple[str, int], int]:
        """Return the place in its queue, from 1, of each waiting round, by job and round."""
        places: dict[tuple[str, int], int] = {}
        for queue in self.queues.values():
            for place, entry in enumerate(queue.get_job_ids(), start=1):
                job, number, _ = entry.split("-")
                places.setdefault((job, int(number)), place)
        return places

    def lengths(self) -> dict[str, int]:
        """Return the number of waiting rounds, by queue."""
        return {name: queue.count for name, queue in self.queues.items()}

    def workers(self) -> int:
        """Return the number of workers that reported within the last minutes."""
        return Worker.count(connection=self._redis)


def open_queue(name: str, redis: Redis) -> Queue:
    """Return an RQ queue with the settings that service and workers share."""
    return Queue(name, connection=redis, serializer=JSONSerializer)
