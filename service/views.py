"""The view of a job that the API returns."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from pydantic.config import JsonDict

from service.contract.jobs import JobState
from service.contract.options import JobOptions
from service.contract.records import Failure, JobStatus
from service.contract.retention import expiry

_EXAMPLE: JsonDict = {
    "id": "5f0c7a1e9b3d4c2f8a6e1d0b7c9f3a52",
    "name": "vase",
    "status": "running",
    "created": "2026-01-05T10:00:00Z",
    "finished": None,
    "cancelling": False,
    "pinned": False,
    "expires": None,
    "step": "train",
    "message": None,
    "stage": "mutual",
    "iteration": 1200,
    "total": 3200,
    "progress": 0.61,
    "eta_seconds": 94.0,
    "step_progress": None,
    "step_eta_seconds": None,
    "training_seconds": 142.5,
    "losses": {"l1": 0.02, "ssim": 0.05},
    "psnr": 29.4,
    "splats": {"surfels": 12000, "gaussians": 9000},
    "previews": {"render": 1200, "normals": 1200},
    "curve": [{"seconds": 20.0, "stage": "warmup_surfels", "iteration": 250, "loss": 0.12, "psnr": 24.1}],
    "queue_position": None,
    "attempt": 1,
    "rerun_of": None,
    "round": 0,
    "memory_bytes": 1500000000,
    "error": None,
    "metrics": {},
    "findings": None,
    "options": {"preset": "standard"},
}


class CurvePoint(BaseModel):
    """A row of the training curve. loss: the total loss of the last iteration. psnr: in dB, on held-out views."""

    seconds: float
    stage: str
    iteration: int
    loss: float | None
    psnr: float | None


class FindingView(BaseModel):
    """A finding of the check of the photographs."""

    code: str = Field(description="The kind of finding, a stable code for programs.", examples=["doubled_structure"])
    severity: Literal["error", "warning", "note"]
    text: str
    amount: float = Field(description="The size of the flaw, in `unit`.")
    unit: str = Field(description="px, sr, deg, share, times, pairs or photographs.")
    cure: str = Field(description="The remedy.")
    photographs: list[str] = Field([], description="The affected photographs; empty if all are affected.")
    places: list[tuple[float, float, float]] = Field(
        [], description="Camera positions from which photographs are missing, in the capture's frame."
    )


class JobView(BaseModel):
    """A job with its status and progress."""

    model_config = ConfigDict(json_schema_extra={"example": _EXAMPLE})

    id: str
    name: str | None
    status: JobStatus
    created: datetime
    finished: datetime | None = None
    cancelling: bool = Field(False, description="Whether a cancel was requested while the job still runs.")
    pinned: bool = Field(False, description="Whether the job is kept beyond the retention.")
    expires: datetime | None = Field(
        None, description="When the service deletes the job with its files; null if it is kept."
    )
    step: str | None = Field(
        None, description="The current step: fetch, unpack, load, start, train, export, render, mesh, ... or publish."
    )
    message: str | None = Field(None, description="The step in words.")
    stage: str | None = Field(None, description="The stage of training.")
    iteration: int | None = None
    total: int | None = Field(None, description="Planned iterations of this stage.")
    progress: float = Field(0.0, ge=0, le=1)
    eta_seconds: float | None = Field(None, description="Estimated seconds left. It is known once training has begun.")
    step_progress: float | None = Field(
        None, ge=0, le=1, description="The progress of the current step, if it is long."
    )
    step_eta_seconds: float | None = Field(None, description="Estimated seconds to the end of the current step.")
    training_seconds: float | None = Field(None, description="Seconds of training so far.")
    losses: dict[str, float | None] = Field({}, description="The weighted loss terms of the last iteration.")
    psnr: float | None = Field(None, description="The PSNR on held-out views, in dB.")
    splats: dict[str, int] = {}
    previews: dict[str, int] = Field(
        {}, description="The names of the pictures at previews/{name}.webp, each with its iteration in the stage."
    )
    curve: list[CurvePoint] = []
    queue_position: int | None = Field(None, description="The position of a queued job, from 1.")
    attempt: int | None = None
    rerun_of: str | None = Field(None, description="The job whose archive this job reuses.")
    round: int = Field(0, description="The number of requested retries.")
    memory_bytes: int | None = Field(None, description="The peak memory of the job process so far.")
    error: Failure | None = None
    metrics: dict[str, Any] = Field({}, description="The main figures of report.json, once the job has succeeded.")
    findings: list[FindingView] | None = Field(
        None, description="The findings of the check of the photographs, worst first; null before it, and in lists."
    )
    options: JobOptions


class JobList(BaseModel):
    """A page of jobs, the newest first. next: the value of `before` for the next page."""

    jobs: list[JobView]
    next: str | None = None


# The fields that come from a worker's progress.
_PROGRESS = (
    *("step", "stage", "iteration", "total", "progress", "eta_seconds", "step_progress", "step_eta_seconds"),
    *("training_seconds", "losses", "psnr", "splats", "previews", "curve", "attempt", "memory_bytes"),
    "findings",
)


def job_view(
    state: JobState, running: bool, progress: dict[str, Any], queue_position: int | None, retention: float | None
) -> JobView:
    """Return the job's view from its state in the store, and from its progress in Redis, if that answers."""
    record, outcome = state.record, state.outcome
    fields: dict[str, Any] = {}
    if progress.get("round") == state.round:
        fields = {name: progress[name] for name in _PROGRESS if name in progress}
        fields["message"] = progress.get("text")
    if outcome is not None:
        fields |= {"status": outcome.status, "finished": outcome.finished, "error": outcome.error}
        fields |= {"eta_seconds": None, "step_progress": None, "step_eta_seconds": None}
        fields |= {"metrics": outcome.metrics, "attempt": outcome.attempt or fields.get("attempt")}
        if outcome.findings is not None:
            fields["findings"] = outcome.findings
        if outcome.status is JobStatus.SUCCEEDED:
            fields |= {"progress": 1.0, "step": "done", "message": None}
    else:
        fields["status"] = JobStatus.RUNNING if running else JobStatus.QUEUED
        fields["queue_position"] = None if running else queue_position
    return JobView(
        id=record.id,
        name=record.options.name,
        created=record.created,
        cancelling=state.cancelling,
        pinned=state.pinned,
        expires=expiry(state, retention),
        rerun_of=record.rerun_of,
        round=state.round,
        options=record.options,
        **fields,
    )
