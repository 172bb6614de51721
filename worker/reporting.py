"""Conversion of a run's events into the worker's reports: progress, time left, and preview pictures."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.pipeline.progress import Event, EventCallback
from mgsr.report.encode import shrunk, webp
from mgsr.training.progress import Progress
from worker.photographs import PhotographFiles

# Seconds between two lines of training progress.
EVERY = 0.5
# Longest side of a preview, pixels.
PREVIEW_SIDE = 640
CURVE_ROWS = 240

# The steps after training take this many seconds, plus this share of the seconds of training.
AFTER_SECONDS = 15.0
AFTER_SHARE = 0.1
# The progress at which each step before training begins. The duration of training is still unknown.
BEFORE = {
    "unpack": 0.0,
    "load": 0.01,
    "check": 0.015,
    "learned_masks": 0.02,
    "start": 0.03,
    "exposures": 0.04,
    "object": 0.043,
    "background": 0.046,
    "plan": 0.05,
    "train": 0.05,
}
# A search for cameras takes this share of the progress, and all of BEFORE follows it.
CAMERAS = 0.3
# The share of the time after training that has passed when each step begins.
AFTER = {"export": 0.0, "mesh": 0.0, "evaluate": 0.5, "model": 0.7, "render": 0.92, "report": 0.96}


class Reporter:
    """A callback for `run_scene` that throttles events, keeps the curve and estimates the time left.

    previews: the folder of preview pictures. emit: receives the reports. log: receives all events.
    """

    def __init__(self, previews: Path, emit: Callable[..., None], log: EventCallback) -> None:
        self._previews = previews
        self._photographs = PhotographFiles(previews)
        self._emit = emit
        self._log = log
        self._step, self._started_at = "", time.monotonic()  # the step, and when it began; training's stays
        self._last = float("-inf")
        self._curve: list[dict[str, Any]] = []
        self._pictures: dict[str, int] = {}
        self._progress = 0.0
        self._searched = False  # for cameras
        self._after = AFTER_SECONDS

    def __call__(self, event: Event) -> None:
        self._log(event)
        if event.scene is not None and event.inspection is not None:
            self._photographs.checked(event.inspection, event.scene)
        elif event.scene is not None:
            self._photographs.masked(event.scene)
        if event.training is not None:
            self._train(event.training)
        elif event.step in BEFORE or event.step == "cameras":
            self._prepare(event)
        elif event.step in AFTER:
            left = self._after * (1 - AFTER[event.step])
            self._emit("step", text=event.text, step=event.step, **self._place(self._reached(left), left))

    def _prepare(self, event: Event) -> None:
        """Report a step before training, with its progress and remaining time if they are known."""
        if event.step != self._step:
            self._step, self._started_at = event.step, time.monotonic()
        self._searched |= event.step == "cameras"
        begin, end = self._bounds(event.step)
        if event.inspection is not None:
            found = event.inspection.to_json()["findings"]
            self._emit("step", text=event.text, step=event.step, findings=found, **self._place(begin, None))
            return
        if not event.done:
            self._emit("step", text=event.text, step=event.step, **self._place(begin, None))
            return
        left = (time.monotonic() - self._started_at) / event.done * (1 - event.done)
        part = {"step_progress": round(event.done, 3), "step_eta_seconds": round(left, 1)}
        place = self._place(begin + (end - begin) * event.done, None)
        self._emit("step", text=event.text, step=event.step, **place | part)

    def _bounds(self, step: str) -> tuple[float, float]:
        """Return the progress at which a step before training begins and ends."""
        if step == "cameras":
            return 0.0, CAMERAS
        begin = BEFORE[step]
        end = min((value for value in BEFORE.values() if value > begin), default=begin)
        return self._after_search(begin), self._after_search(end)

    def _after_search(self, progress: float) -> float:
        """Rescale progress 0..1 to leave room for the search for cameras."""
        return CAMERAS + (1 - CAMERAS) * progress if self._searched else progress

    def _train(self, training: Progress) -> None:
        for name, picture in training.previews.items():
            self._write_preview(name, picture)
            self._pictures[name] = training.iteration
        at_end = training.iteration == training.total
        if time.monotonic() - self._last < EVERY and not at_end:
            return
        self._last = time.monotonic()
        left = self._left(training)
        self._note(training)
        begin = self._after_search(BEFORE["train"])
        self._emit(
            "progress",
            step="train",
            stage=training.stage,
            iteration=training.iteration,
            total=training.total,
            **self._place(begin if left is None else self._reached(left, training.seconds), left),
            training_seconds=round(training.seconds, 1),
            losses={name: _finite(value) for name, value in training.losses.items()},
            psnr=_finite(training.psnr),
            splats=training.counts,
            previews=self._pictures,
            curve=self._curve,
        )

    def _note(self, training: Progress) -> None:
        """Add a row to the curve; a long curve is thinned by half."""
        self._curve.append(
            {
                "seconds": round(training.seconds, 1),
                "stage": training.stage,
                "iteration": training.iteration,
                "loss": _finite(sum(training.losses.values())),
                "psnr": _finite(training.psnr),
            }
        )
        if len(self._curve) > CURVE_ROWS:
            self._curve = self._curve[::2]

    def _left(self, training: Progress) -> float | None:
        """Return the seconds to the end of the run: the rest of training at its pace so far, and the steps after it.

        Returns None until a hundredth of training is done.
        """
        if training.done < 0.01:
            return None
        whole_training = training.seconds / training.done
        self._after = AFTER_SECONDS + AFTER_SHARE * whole_training
        return whole_training - training.seconds + self._after

    def _reached(self, left: float, trained: float = 0.0) -> float:
        """Return progress 0..1 as a share of time. trained: seconds of training, with those before a resume."""
        spent = max(time.monotonic() - self._started_at, trained)
        begin = self._after_search(BEFORE["train"])
        return begin + (1 - begin) * spent / (spent + left)

    def _place(self, progress: float, left: float | None) -> dict[str, Any]:
        """Return the fields of progress, which never falls, and time left. The fields of the step itself are None."""
        self._progress = max(self._progress, min(progress, 0.99))
        whole = {"progress": round(self._progress, 4), "eta_seconds": None if left is None else round(left, 1)}
        return whole | {"step_progress": None, "step_eta_seconds": None}

    def _write_preview(self, name: str, picture: np.ndarray) -> None:
        self._previews.mkdir(exist_ok=True)
        partial = self._previews / f".{name}"
        partial.write_bytes(webp(shrunk(picture, PREVIEW_SIDE)))
        os.replace(partial, self._previews / f"{name}.webp")


def _finite(value: float | None) -> float | None:
    return round(value, 6) if value is not None and math.isfinite(value) else None
