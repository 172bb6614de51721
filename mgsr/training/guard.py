"""The guard of a training: it detects steps with invalid numbers, undoes them and logs them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mgsr.errors import TrainingError
from mgsr.ops.adam import any_bad
from mgsr.ops.arrays import on_gpu
from mgsr.training.schedule import SH_NAMES
from mgsr.training.stages import Stage, Step
from mgsr.training.trainable import Kind, Trainable, copied

log = logging.getLogger("mgsr.training")

# A loss diverges when its mean since the last check exceeds the usual loss by this factor and by this amount. Losses of
# images within 0..1 start near 0.3 and end near 0.03.
BLOW_UP_FACTOR, BLOW_UP_RISE = 5.0, 0.1
# Consecutive bad steps before the branches are restored, and consecutive restorations before training fails.
MOST_BAD_STEPS, MOST_RETURNS = 3, 3
MOST_INCIDENTS = 100  # kept for the report; all are logged


class Guard:
    """A guard that watches one stage's steps.

    A step is bad when its loss or a gradient is not finite or exceeds 1e19. The square of a larger number overflows
    float32, and with it Adam's second moment. The guard skips a bad step, and training continues with the next view.

    Every `every` steps the guard also checks the parameters and the loss. If a parameter is not finite, or the loss
    has blown up, it restores the state of the last good check.

    On a GPU the host reads nothing between two checks. There, the optimiser treats a bad step's gradients as zero.
    """

    def __init__(self, stage: Stage, every: int, incidents: list[str]) -> None:
        self.stage = stage
        self.every = every
        self.incidents = incidents
        self._losses: list[Tensor] = []
        self._dropped: list[Tensor] = []
        self.bad: Tensor | None = None  # [] bool, on a GPU: whether the step's gradients count as zero
        self._bad_steps = self._returns = 0
        self._usual: float | None = None
        self._kept = self._copies()

    def admits(self, step: Step, view: str) -> bool:
        """Return whether the optimiser may take the step.

        On a GPU the answer is always yes; the optimiser then reads `bad` and treats the gradients of a bad step as
        zero. Raises TrainingError if restoring the last good state fails repeatedly.
        """
        # Gradients of colours are not checked, to save time: a bad one comes with a bad gradient of opacity or centre.
        bad = any_bad([step.loss.values, *_tensors(self.stage.trainables, "grad", without=SH_NAMES)])
        if on_gpu(bad):
            self._dropped.append(bad)
            self.bad = bad
            return True
        if not bool(bad):
            self._bad_steps = 0
            return True
        self._note(f"the step on view {view} was skipped: {', '.join(self._bad_names(step))} not finite")
        self._bad_steps += 1
        if self._bad_steps == MOST_BAD_STEPS:
            self._go_back(", ".join(self._bad_names(step)) + " not finite")
        return False

    def look_back(self, values: Tensor) -> None:
        """Record the loss of a completed step, and check the recent steps when a check is due.

        values [...]: the terms of the loss, of any shape. Raises TrainingError if the steps stay bad after the state
        was restored MOST_RETURNS times.
        """
        self._losses.append(values)
        if len(self._losses) < self.every:
            return
        mean = float(torch.stack([values.sum() for values in self._losses]).nanmean())
        self._report_dropped()
        trouble = self._trouble(mean)
        if trouble:
            self._go_back(trouble)
            return
        self._usual = mean if self._usual is None else 0.5 * (self._usual + mean)
        self._losses, self._returns, self._kept = [], 0, self._copies()

    def expect_anew(self) -> None:
        """Forget the usual loss before an expected rise, such as after an opacity reset."""
        self._usual, self._losses, self._kept = None, [], self._copies()

    def state(self) -> dict[str, Any]:
        """Return the guard's state for a checkpoint, including the copy from the last good check."""
        return {
            "losses": list(self._losses),
            "dropped": list(self._dropped),
            "bad_steps": self._bad_steps,
            "returns": self._returns,
            "usual": self._usual,
            "kept": self._kept,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned; the branches may be on other devices."""
        device = self.stage.trainables[0].device
        self._losses = [loss.to(device) for loss in state["losses"]]
        self._dropped = [bad.to(device) for bad in state["dropped"]]
        self._bad_steps, self._returns = state["bad_steps"], state["returns"]
        self._usual, self._kept = state["usual"], state["kept"]

    def _trouble(self, mean: float) -> str:
        if bool(any_bad(_tensors(self.stage.trainables, "values"))):
            return ", ".join(self._bad_names(None)) + " not finite"
        if self._usual is not None and not mean <= BLOW_UP_FACTOR * self._usual + BLOW_UP_RISE:
            return f"the loss rose from {self._usual:.3g} to {mean:.3g}"
        return ""

    def _go_back(self, trouble: str) -> None:
        self._returns += 1
        where = f"{self.stage.name}, iteration {self.stage.iteration}"
        if self._returns == MOST_RETURNS:
            raise TrainingError(
                f"{where}: {trouble} again after undoing steps; lower the learning rates or that term's weight, and "
                "check images and poses"
            )
        self._note(f"the last {len(self._losses)} steps were undone: {trouble}")
        for part in self.stage.trainables:
            steps = part.steps  # the learning rates continue to decay
            part.restore(copied(self._kept[part.name]))
            part.steps = steps
        self._losses, self._bad_steps = [], 0

    def _report_dropped(self) -> None:
        count = int(torch.stack(self._dropped).sum()) if self._dropped else 0
        self._dropped = []
        if count:
            self._note(f"{count} of the last {self.every} steps were skipped, because numbers were not finite")

    def _bad_names(self, step: Step | None) -> list[str]:
        terms = {} if step is None else step.loss.terms
        bad = [name for name, term in terms.items() if not bool(torch.isfinite(term))]
        kind: Kind = "values" if step is None else "grad"
        return bad or [name for part in self.stage.trainables for name in part.bad(kind)]

    def _note(self, text: str) -> None:
        incident = f"{self.stage.name}, iteration {self.stage.iteration}: {text}"
        log.warning(incident)
        if len(self.incidents) < MOST_INCIDENTS:
            self.incidents.append(incident)

    def _copies(self) -> dict[str, Any]:
        return {part.name: copied(part.state()) for part in self.stage.trainables}


def _tensors(trainables: Sequence[Trainable[Any]], kind: Kind, without: tuple[str, ...] = ()) -> list[Tensor]:
    named = (item for part in trainables for item in part.tensors(kind).items())
    return [tensor for name, tensor in named if name not in without]
