"""The tasks that the queue may ask of a worker, by name."""

from __future__ import annotations

from worker.rq_worker import current_worker


def run_job(job: str, number: int) -> None:
    """Work on round `number` of a job."""
    worker = current_worker.get()
    worker.rounds.take(job, number, worker.heartbeat)
