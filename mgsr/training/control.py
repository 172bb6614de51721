"""What the caller of a training controls while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mgsr.training.progress import ProgressCallback
from mgsr.training.stage_scheduler import StageScheduler


@dataclass(frozen=True)
class TrainingControl:
    """The caller's control of a training.

    progress: called every `watch.report_every` iterations and at each stage's end.
    should_stop: called before every iteration. Once it returns True, a checkpoint is written and Cancelled raised.
    checkpoint_path: one file, written at intervals (config.train.watch) and at the end.
    resume: continue from the checkpoint if it exists. On the CPU the result equals an uninterrupted run's bit for bit.
    deadline: seconds after which training ends at once; the stages' reports name the deadline as the reason.
    scheduler: sets the lengths of all stages.
    """

    progress: ProgressCallback | None = None
    should_stop: Callable[[], bool] | None = None
    checkpoint_path: Path | None = None
    resume: bool = False
    deadline: float | None = None
    scheduler: StageScheduler | None = None
