"""What training reports to its caller, while it runs and at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mgsr.gaussians.trained_model import TrainedModel


@dataclass(frozen=True)
class CurveRow:
    """One row of the curve of error against time.

    psnr_*: the PSNR, dB, of each branch's full colour over a few test views, on white where there are masks; None for
    a missing branch. Training only reports these values and decides nothing by them.
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

    iteration, total: the completed and the planned iterations of this stage.
    done: the completed share, 0..1, of all stages' planned iterations.
    losses: the last iteration's weighted loss terms, by name.
    counts: the number of splats of each branch.
    psnr: the last PSNR of the curve, dB.
    previews: images [H,W,3] uint8 by name, where they are due.
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

    It has the stage's iterations and seconds, the reason why it ended (iterations, converged, budget or deadline), and
    the number of splats that were dropped at its end.
    """

    name: str
    iterations: int
    seconds: float
    stop_reason: str
    dropped: int = 0


@dataclass(frozen=True)
class TrainResult:
    """The trained model without gradients, and the reports on its training.

    incidents: descriptions of the first 100 bad steps that were undone (see `mgsr.training.guard`).
    tried: the PSNR, dB, of each reflection model on held-out photographs; empty without a model selection.
    degrees: the PSNR, dB, of each lower degree of the transmitted colour there; empty without a model selection.
    """

    model: TrainedModel
    stages: list[StageReport]
    curve: list[CurveRow]
    seconds: float
    incidents: list[str] = field(default_factory=list)
    tried: dict[str, float] = field(default_factory=dict)
    degrees: dict[int, float] = field(default_factory=dict)


ProgressCallback = Callable[[Progress], None]
