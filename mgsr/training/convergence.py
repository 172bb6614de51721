"""Tests for whether a warm-up has converged.

They include the paper's own rule.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from torch import Tensor

from mgsr.config import PaperConfig, StopRule, WarmupConfig


class Convergence(Protocol):
    """A test that receives every iteration's loss and decides when training has converged."""

    def converged(self, loss: Tensor, iteration: int, at_epoch_end: bool) -> bool:
        """Take the loss [] of one iteration, counted from 1 and without gradient, and return whether to stop."""

    def state(self) -> dict[str, Any]:
        """Return everything that the test remembers, for a checkpoint."""

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""


def make_convergence(
    warmup: WarmupConfig, paper: PaperConfig, iterations: int, validation_psnr: Callable[[], float]
) -> Convergence | None:
    """Return the convergence test that the settings name for a warm-up of at most `iterations`, or None for none.

    validation_psnr measures the branch on held-out views.
    """
    earliest = int(warmup.stop_after * iterations)
    if paper.stop_rule is StopRule.EPOCH:
        return EpochMeans(earliest, warmup.epoch_span, warmup.epoch_gain)
    if paper.stop_rule is StopRule.VALIDATION:
        return Validation(earliest, paper, validation_psnr)
    return LossRange(earliest, paper.loss_range) if paper.stop_rule is StopRule.PAPER else None


class EpochMeans:
    """The test that compares mean losses over whole epochs.

    Training has converged when the mean loss of the last `span` epochs is less than a fraction `gain` below the mean of
    the preceding `span` epochs. Whole epochs hold the same views, so only the model's change is measured.
    """

    def __init__(self, earliest: int, span: int, gain: float) -> None:
        self.earliest, self.span, self.gain = earliest, span, gain
        self.total: Tensor | float = 0.0
        self.count = 0
        self.means: list[float] = []

    def converged(self, loss: Tensor, iteration: int, at_epoch_end: bool) -> bool:
        self.total = self.total + loss
        self.count += 1
        if not at_epoch_end:
            return False
        self.means = [*self.means, float(self.total) / self.count][-2 * self.span :]
        self.total, self.count = 0.0, 0
        if iteration < self.earliest or len(self.means) < 2 * self.span:
            return False
        before, after = sum(self.means[: self.span]), sum(self.means[self.span :])
        return after > before * (1 - self.gain)

    def state(self) -> dict[str, Any]:
        return {"total": self.total, "count": self.count, "means": self.means}

    def restore(self, state: dict[str, Any]) -> None:
        self.total, self.count, self.means = state["total"], state["count"], state["means"]


class Validation:
    """The test on held-out views.

    Training has converged when `validation_patience` consecutive checks have not improved the best PSNR by
    `validation_gain` dB.
    """

    def __init__(self, earliest: int, config: PaperConfig, measure: Callable[[], float]) -> None:
        self.earliest, self.config, self.measure = earliest, config, measure
        self.best = float("-inf")
        self.idle = 0

    def converged(self, loss: Tensor, iteration: int, at_epoch_end: bool) -> bool:
        if iteration % self.config.validation_every:
            return False
        psnr = self.measure()
        gained = psnr > self.best + self.config.validation_gain
        self.best = max(psnr, self.best) if gained else self.best
        self.idle = 0 if gained else self.idle + 1
        return iteration >= self.earliest and self.idle >= self.config.validation_patience

    def state(self) -> dict[str, Any]:
        return {"best": self.best, "idle": self.idle}

    def restore(self, state: dict[str, Any]) -> None:
        self.best, self.idle = state["best"], state["idle"]


class LossRange:
    """The paper's rule: training has converged when the last 100 losses, of any views, lie within `width`."""

    LOOK_BACK = 100

    def __init__(self, earliest: int, width: float) -> None:
        self.earliest, self.width = earliest, width
        self.losses: list[float] = []

    def converged(self, loss: Tensor, iteration: int, at_epoch_end: bool) -> bool:
        self.losses = [*self.losses, float(loss)][-self.LOOK_BACK :]
        full = len(self.losses) == self.LOOK_BACK
        return iteration >= self.earliest and full and max(self.losses) - min(self.losses) < self.width

    def state(self) -> dict[str, Any]:
        return {"losses": self.losses}

    def restore(self, state: dict[str, Any]) -> None:
        self.losses = state["losses"]
