"""A puppet worker that takes a job and reports what a test wants, without training anything."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from redis import Redis

from service.contract.jobs import Jobs, attempt_path
from service.contract.live import Live
from service.contract.records import Artifact, Failure, JobStatus, Outcome, now
from service.contract.settings import Settings
from service.contract.store import Store
from tests.service.stack import Stack
from worker.publish import media_type

HOLDER = "puppet"
LEASE = 600.0


class Puppet:
    """Works on one job of a stack that has no worker."""

    def __init__(self, stack: Stack, job: str) -> None:
        settings = Settings(home=stack.folder, redis_url=stack.server.url)
        self.jobs, self.job = Jobs(Store(settings.store_url, 5.0)), job
        self.live = Live(Redis.from_url(stack.server.url))
        self.round = self.jobs.last_round(job)
        assert self.live.take_lease(job, HOLDER, LEASE)
        self.attempt = self.jobs.begin_attempt(job, self.round, HOLDER)
        self._known: dict[str, Any] = {}

    def tell(self, **change: Any) -> None:
        """Report progress, as the worker's reporter sends it."""
        change |= {"status": "running"}
        self._known |= change | {"round": self.round, "attempt": self.attempt}
        self.live.keep_progress(self.job, self._known, change)

    def train(self, share: float, stage: str = "mutual", previews: dict[str, bytes] | None = None) -> None:
        """Report a point of training, with pictures; `share` 0..1 of it is done."""
        iteration = round(1000 * share)
        for name, data in (previews or {}).items():
            self.jobs.store.replace(attempt_path(self.job, self.attempt, f"previews/{name}.webp"), data)
        row = {"seconds": 100 * share, "stage": stage, "iteration": iteration}
        row |= {"loss": 0.3 - 0.2 * share, "psnr": 18 + 10 * share}
        self.tell(
            step="train",
            stage=stage,
            iteration=iteration,
            total=1000,
            progress=share,
            eta_seconds=100 * (1 - share),
            training_seconds=row["seconds"],
            losses={"l1": row["loss"]},
            psnr=row["psnr"],
            splats={"surfels": 9000},
            previews={name: iteration for name in previews or {}},
            memory_bytes=800_000_000,
            curve=[*self._known.get("curve", []), row],
        )

    def succeed(self, files: dict[str, bytes], metrics: dict[str, Any]) -> None:
        """End the round with these results."""
        artifacts = [self._publish(name, data) for name, data in sorted(files.items())]
        self._end(
            Outcome(
                status=JobStatus.SUCCEEDED, attempt=self.attempt, finished=now(), artifacts=artifacts, metrics=metrics
            )
        )

    def check(self, findings: list[dict[str, Any]]) -> None:
        """Report what a check of the photographs found."""
        self.tell(step="check", text="the photographs are checked", progress=0.02, findings=findings)

    def show_photographs(self, folder: Path) -> None:
        """Hand on the files that tell of the photographs."""
        for path in folder.iterdir():
            self.jobs.store.replace(attempt_path(self.job, self.attempt, f"previews/{path.name}"), path.read_bytes())

    def fail(self, code: str, message: str, retryable: bool) -> None:
        """End the round with an error."""
        error = Failure(code=code, message=message, retryable=retryable, peak_memory_bytes=3_000_000_000)
        self._end(Outcome(status=JobStatus.FAILED, attempt=self.attempt, finished=now(), error=error))

    def stop_as_asked(self) -> None:
        """End the round as cancelled."""
        self._end(Outcome(status=JobStatus.CANCELLED, attempt=self.attempt, finished=now()))

    def asked_to_stop(self) -> bool:
        """Return whether someone wants the round to stop."""
        return self.live.cancel_asked(self.job, self.round)

    def _publish(self, name: str, data: bytes) -> Artifact:
        self.jobs.store.replace(attempt_path(self.job, self.attempt, name), data)
        digest = hashlib.sha256(data).hexdigest()
        return Artifact(name=name, size=len(data), sha256=digest, content_type=media_type(name))

    def _end(self, outcome: Outcome) -> None:
        assert self.jobs.finish(self.job, self.round, outcome)
        self.live.publish(self.job, "status", {"status": outcome.status, "round": self.round})
        self.live.release_lease(self.job, HOLDER)
