"""What training reports to its caller, while it runs and at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mgsr.gaussians.trained_model import TrainedModel


@dataclass(frozen=True)
class CurveRow:
    """One row of the curve of error against time.

    psnr_*: dB over a few test views (on white where there are masks), each branch's full colour, None for a branch
    that is not there. They are only reported: nothing is decided by them.
    """

    seconds: float
    stage: str
    iteration: int
    psnr_surfels: float | None
    psnr_gaussians: float | None
    surfels: int
    gaussians: int

    @property
    def psnr(self) -> float | None:
        """Return the PSNR, dB, of the rendering branch, or of the only branch."""
        return self.psnr_surfels if self.psnr_gaussians is None else self.psnr_gaussians


@dataclass(frozen=True)
class Progress:
    """The progress of a training.

    iteration of total in this stage; done: 0..1 of all stages' planned iterations; losses: the last iteration's terms
    by name, times their weights; counts: splats by branch; psnr: the curve's last; previews: images [H,W,3] uint8 by
    name, where they are due.
    """

    stage: str
    iteration: int
    total: int
    done: float
    seconds: float
    losses: dict[str, float]
    counts: dict[str, int]
    psnr: float | None
    previews: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class StageReport:
    """The report of a finished stage.

    Its iterations, seconds, why it ended (iterations, converged, budget or deadline), and how many splats were dropped
    then.
    """

    name: str
    iterations: int
    seconds: float
    stop_reason: str
    dropped: int = 0


@dataclass(frozen=True)
class TrainResult:
    """The trained model without gradients, and how it came about.

    incidents: each bad step that was undone, in words (see `mgsr.training.guard`); the first 100. tried: PSNR, dB, that
    each candidate for the reflection reached in model selection, on held-out photographs, and degrees: what lower
    degrees of the transmitted colour reached there; empty without one.
    """

    model: TrainedModel
    stages: list[StageReport]
    curve: list[CurveRow]
    seconds: float
    incidents: list[str] = field(default_factory=list)
    tried: dict[str, float] = field(default_factory=dict)
    degrees: dict[int, float] = field(default_factory=dict)


ProgressCallback = Callable[[Progress], None]
