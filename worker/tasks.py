"""The tasks that workers run, which the queue names."""

from __future__ import annotations

from rq import get_current_job

from worker.rq_worker import current_worker


def run_job(job: str, number: int) -> None:
    """Work on round `number` of a job."""
    worker = current_worker.get()
    entry = get_current_job()
    worker.rounds.take(job, number, worker.heartbeat, None if entry is None else entry.enqueued_at)
