"""Turns a run's events into what the worker passes on: progress that a person believes, and preview pictures."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.cli.events import Event, EventCallback
from mgsr.report.encode import shrunk, webp
from mgsr.training.progress import Progress

# Seconds between two lines of training progress.
EVERY = 0.5
# Longest side of a preview, pixels.
PREVIEW_SIDE = 640
CURVE_ROWS = 240

# Where each step begins, as shares of the whole run's time (measured: draft and standard presets, 48 views of
# 256 x 256 pixels, on a CPU). Training fills the gap up to `export`.
STARTS = {
    "unpack": 0.0,
    "load": 0.01,
    "start": 0.02,
    "train": 0.08,
    "export": 0.82,
    "render": 0.825,
    "mesh": 0.84,
    "evaluate": 0.94,
    "report": 0.97,
}


class Reporter:
    """A callback for `run_scene`: keeps the curve, throttles, estimates the time left. All events also go to `log`."""

    def __init__(self, previews: Path, emit: Callable[..., None], log: EventCallback) -> None:
        self._previews = previews
        self._emit = emit
        self._log = log
        self._begun = time.monotonic()
        self._last = float("-inf")
        self._curve: list[dict[str, Any]] = []

    def __call__(self, event: Event) -> None:
        self._log(event)
        if event.training is not None:
            self._train(event.training)
        elif event.step in STARTS:
            self._emit("step", text=event.text, **self._place(event.step))

    def _train(self, training: Progress) -> None:
        for name, picture in training.previews.items():
            self._write_preview(name, picture)
        at_end = training.iteration == training.total
        if time.monotonic() - self._last < EVERY and not at_end:
            return
        self._last = time.monotonic()
        progress = STARTS["train"] + training.done * (STARTS["export"] - STARTS["train"])
        self._note(training)
        self._emit(
            "progress",
            step="train",
            stage=training.stage,
            iteration=training.iteration,
            total=training.total,
            progress=round(progress, 4),
            eta_seconds=_left(training),
            losses={name: _finite(value) for name, value in training.losses.items()},
            psnr=_finite(training.psnr),
            splats=training.counts,
            curve=self._curve,
        )

    def _note(self, training: Progress) -> None:
        """Add a row to the curve; a long run's is thinned by half when it gets long."""
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

    def _place(self, step: str) -> dict[str, Any]:
        """Where a step stands in the run; the time left from the shares alone, once training is behind."""
        begins = STARTS[step]
        spent = time.monotonic() - self._begun
        left = round(spent * (1 - begins) / begins, 1) if begins >= STARTS["export"] else None
        return {"step": step, "progress": begins, "eta_seconds": left}

    def _write_preview(self, name: str, picture: np.ndarray) -> None:
        self._previews.mkdir(exist_ok=True)
        partial = self._previews / f".{name}"
        partial.write_bytes(webp(shrunk(picture, PREVIEW_SIDE)))
        os.replace(partial, self._previews / f"{name}.webp")


def _left(training: Progress) -> float | None:
    """Seconds to the run's end: the rest of training at its pace so far, then the steps after it by their share."""
    if training.done < 0.01:
        return None
    whole_training = training.seconds / training.done
    after = whole_training * (1 - STARTS["export"]) / (STARTS["export"] - STARTS["train"])
    return round(whole_training - training.seconds + after, 1)


def _finite(value: float | None) -> float | None:
    return round(value, 6) if value is not None and math.isfinite(value) else None
