"""The health check of a container: whether a worker of this machine is alive."""

from __future__ import annotations

import socket
from datetime import UTC, datetime

from redis import Redis, RedisError
from rq import Worker
from rq.worker import BaseWorker

# An idle worker reports every 45 s, a worker with a job every 10 s.
SILENT_SECONDS = 120.0


def worker_health(redis: Redis) -> tuple[bool, str]:
    """Return whether a worker of this host has reported recently, and a line about it.

    If the Redis server does not answer, the worker counts as healthy, because it waits for the server.
    """
    host = socket.gethostname()
    try:
        workers = [worker for worker in Worker.all(connection=redis) if worker.name.rsplit(".", 2)[0] == host]
    except RedisError as error:
        return True, f"unknown: Redis does not answer: {error}"
    if not workers:
        return False, f"no worker of {host} has registered"
    silent = min(_silence(worker) for worker in workers)
    return silent < SILENT_SECONDS, f"{len(workers)} of {host}, the last heartbeat {silent:.0f} s ago"


def _silence(worker: BaseWorker) -> float:
    spoke = worker.last_heartbeat
    if spoke is None:
        return float("inf")
    return (datetime.now(UTC) - spoke.replace(tzinfo=spoke.tzinfo or UTC)).total_seconds()
