"""The training loop: it runs the stages of a plan, and reports and saves at intervals."""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mgsr.config import TrainConfig
from mgsr.errors import Cancelled
from mgsr.losses.loss import Loss
from mgsr.training.checkpoint import load_checkpoint, save_checkpoint
from mgsr.training.control import TrainingControl
from mgsr.training.evaluate import mean_psnr, preview_pictures
from mgsr.training.guard import Guard
from mgsr.training.plan import Plan
from mgsr.training.progress import CurveRow, Progress, StageReport
from mgsr.training.stages import ModelSelection, Stage, Step
from mgsr.training.trainable import step_trainables
from mgsr.training.views import pick_background


class Trainer:
    """The training loop of a plan.

    Its state consists of the plan's and the guard's state, the stage's number, the reports and the clock. A checkpoint
    holds all of it.

    control: the callbacks, the checkpoint and the limits. `resume` restores from the checkpoint.
    """

    def __init__(
        self,
        plan: Plan,
        config: TrainConfig,
        run_fingerprint: dict[str, str],
        control: TrainingControl = TrainingControl(),
    ) -> None:
        self.plan = plan
        self.config = config
        self.fingerprint = run_fingerprint
        self.control = control
        self.stage_index = 0
        self.reports: list[StageReport] = []
        self.curve: list[CurveRow] = []
        self.incidents: list[str] = []
        self.guard: Guard | None = None  # of the stage that runs
        self._clock_start = self._left_at = time.perf_counter()
        self._saved_at = 0.0

    @property
    def seconds(self) -> float:
        """Return the seconds spent on this run: also those before a resume, but not those between calls of `run`."""
        return time.perf_counter() - self._clock_start

    def run(self, before: str | None = None) -> None:
        """Run the remaining stages, up to but excluding the stage `before`.

        Raises Cancelled once should_stop returns True, and TrainingError if training diverges.
        """
        self._clock_start += time.perf_counter() - self._left_at
        while self.stage_index < len(self.plan.stages):
            stage = self.plan.stages[self.stage_index]
            if stage.name == before:
                break
            started_at = self.seconds - stage.seconds
            reason = self._run_stage(stage, started_at)
            self.guard = None
            dropped = 0 if stage.prune is None else stage.prune()
            self.reports.append(StageReport(stage.name, stage.iteration, stage.seconds, reason, dropped))
            self.stage_index += 1
            self.save()
        self._left_at = time.perf_counter()

    def save(self) -> None:
        """Write a checkpoint, if there is a path for it."""
        if self.control.checkpoint_path is not None:
            save_checkpoint(self.control.checkpoint_path, self.state())
        self._saved_at = self.seconds

    def state(self) -> dict[str, Any]:
        """Return everything that the remaining run depends on, as plain values and tensors."""
        return {
            "fingerprint": self.fingerprint,
            "stage_index": self.stage_index,
            "seconds": self.seconds,
            "stages": [stage.state() for stage in self.plan.stages],
            "trainables": {part.name: part.state() for part in self.plan.train_state.trainables},
            "reports": [asdict(report) for report in self.reports],
            "curve": [asdict(row) for row in self.curve],
            "incidents": self.incidents,
            "guard": None if self.guard is None else self.guard.state(),
            "scheduler": None if self.control.scheduler is None else self.control.scheduler.state(),
        }

    def resume(self) -> None:
        """Restore the run from its checkpoint.

        Raises CheckpointError if it is damaged or belongs to another run.
        """
        assert self.control.checkpoint_path is not None
        state = load_checkpoint(self.control.checkpoint_path, self.fingerprint)
        self.stage_index = state["stage_index"]
        self._left_at = time.perf_counter()
        self._clock_start = self._left_at - state["seconds"]
        self._saved_at = state["seconds"]
        for stage, saved in zip(self.plan.stages, state["stages"], strict=True):
            stage.restore(saved)
        for part in self.plan.train_state.trainables:
            part.restore(state["trainables"][part.name])
        self.reports = [StageReport(**report) for report in state["reports"]]
        self.curve = [CurveRow(**row) for row in state["curve"]]
        self.incidents = state["incidents"]
        if state["guard"] is not None:
            self.guard = self._new_guard(self.plan.stages[self.stage_index])
            self.guard.restore(state["guard"])

    def _new_guard(self, stage: Stage) -> Guard:
        return Guard(stage, self.config.watch.check_every, self.incidents)

    def _run_stage(self, stage: Stage, started_at: float) -> str:
        """Iterate to the stage's end, and return why it ended."""
        reason = "iterations" if self.control.scheduler is None else "budget"
        guard = self.guard = self.guard or self._new_guard(stage)
        self._apply_schedule(stage)
        while stage.iteration < stage.iterations:
            stage.seconds = self.seconds - started_at
            self._check_caller(stage)
            if self.control.deadline is not None and self.seconds > self.control.deadline:
                return "deadline"
            if stage.selection is not None and stage.selection.due(stage):
                self._select_model(stage, stage.selection)
                guard.expect_anew()
            loss, converged = self._iterate(stage, guard)
            stage.seconds = self.seconds - started_at
            last = converged or stage.iteration == stage.iterations
            self._watch(stage, loss, last)
            if converged:
                reason = "converged"
                break
            if not last:
                self._apply_schedule(stage)
        return reason

    def _apply_schedule(self, stage: Stage) -> None:
        if self.control.scheduler is not None:
            stage.iterations = self.control.scheduler.length(self.plan.stages, self.stage_index, self._counts())

    def _select_model(self, stage: Stage, selection: ModelSelection) -> None:
        """Run the stage's model selection. A run that stops during it repeats it on resume."""
        self.save()
        done_before = self._done(stage)

        def train(candidate: str, iterations: int) -> None:
            """Train a candidate. Raises Cancelled if a stop is requested."""
            guard = Guard(stage, self.config.watch.check_every, self.incidents)
            for done in range(iterations):
                if self.control.should_stop is not None and self.control.should_stop():
                    raise self._cancelled(f"stopped on request while model selection trained {candidate}")
                loss, _ = self._iterate(stage, guard)
                if self.control.progress is not None and (done + 1) % self.config.watch.report_every == 0:
                    report = self._report(stage, loss, last=False)
                    report = replace(report, stage=f"selection_{candidate}", iteration=done + 1, total=iterations)
                    self.control.progress(replace(report, done=done_before, previews={}))

        selection.run(stage, train)

    def _check_caller(self, stage: Stage) -> None:
        if self.control.should_stop is not None and self.control.should_stop():
            self.save()
            raise self._cancelled(f"stopped on request in {stage.name} after {stage.iteration} iterations")

    def _cancelled(self, what: str) -> Cancelled:
        kept = "" if self.control.checkpoint_path is None else f"; {self.control.checkpoint_path.name} holds the state"
        return Cancelled(what + kept)

    def _iterate(self, stage: Stage, guard: Guard) -> tuple[Loss, bool]:
        """Render one view, compute its loss, step and densify; return the loss and whether the stage has converged."""
        view = stage.next_view()
        background = pick_background(self.plan.backdrop, stage.cycle.generator)
        step = stage.compute(view, background, stage.iteration)
        step.loss.backward()
        stage.iteration += 1
        if not guard.admits(step, view.name):
            for part in stage.trainables:
                part.skip_step()
            return step.loss, False
        self._update(stage, step, view.whole, guard)
        guard.look_back(step.loss.values)
        if stage.convergence is None:
            return step.loss, False
        return step.loss, stage.convergence.converged(
            step.loss.value.detach(), stage.iteration, stage.cycle.at_epoch_end
        )

    def _update(self, stage: Stage, step: Step, whole: tuple[int, int], guard: Guard) -> None:
        """Step the optimisers and, where they are due, densify and reset.

        whole: the width and height of the photograph of which the step rendered a part.
        """
        step_trainables({part: stage.progress(part, stage.iteration) for part in stage.trainables}, guard.bad)
        for branch in stage.branches:
            first, last = stage.window(branch.densify)
            if not stage.iteration <= last:
                continue
            for render in step.renders:
                if render.branch is branch:
                    branch.gather(render.stats, *whole, render.weight, guard.bad)
            if stage.iteration % branch.densify.every == 0 and stage.iteration >= first:
                stage.adapt(branch)
            reset = branch.densify.reset_every
            if reset is not None and stage.iteration % reset == 0 and stage.iteration + reset <= last:
                branch.reset_opacities()
                guard.expect_anew()

    def _watch(self, stage: Stage, loss: Loss, last: bool) -> None:
        """Extend the curve, report, and save, each if it is due."""
        watch, iteration = self.config.watch, stage.iteration
        if last or iteration % watch.curve_every == 0:
            self.curve.append(self._curve_row(stage))
        if self.control.progress is not None and (last or iteration % watch.report_every == 0):
            self.control.progress(self._report(stage, loss, last))
        if (iteration % watch.checkpoint_every == 0 or self._checkpoint_overdue()) and not last:
            self.save()

    def _checkpoint_overdue(self) -> bool:
        longest = self.config.watch.checkpoint_seconds
        return longest is not None and self.seconds - self._saved_at >= longest

    def _curve_row(self, stage: Stage) -> CurveRow:
        psnr = {branch.name: self._psnr(branch.name) for branch in self.plan.train_state.branches}
        counts = self._counts()
        return CurveRow(
            self.seconds,
            stage.name,
            stage.iteration,
            psnr.get("surfels"),
            psnr.get("gaussians"),
            counts.get("surfels", 0),
            counts.get("gaussians", 0),
        )

    def _psnr(self, branch: str) -> float | None:
        if not self.plan.curve_views:
            return None
        return mean_psnr(self.plan.train_state.picture(branch), self.plan.curve_views, self.plan.backdrop.color)

    def _report(self, stage: Stage, loss: Loss, last: bool) -> Progress:
        every = self.config.watch.preview_every
        due = every is not None and (last or stage.iteration % every == 0)
        return Progress(
            stage=stage.name,
            iteration=stage.iteration,
            total=stage.iterations,
            done=self._done(stage),
            seconds=self.seconds,
            losses={name: float(term) for name, term in loss.terms.items()},
            counts=self._counts(),
            psnr=self.curve[-1].psnr if self.curve else None,
            previews=self._previews() if due else {},
        )

    def _previews(self) -> dict[str, np.ndarray]:
        """Return pictures of the curve's first view, or of the first training view if the curve has none."""
        plan = self.plan
        view = (plan.curve_views or plan.stages[-1].views)[0]
        return preview_pictures(plan.train_state.model, view, plan.backdrop.color)

    def _done(self, stage: Stage) -> float:
        planned = sum(each.iterations for each in self.plan.stages)
        spent = sum(each.iterations for each in self.plan.stages[: self.stage_index]) + stage.iteration
        return spent / max(1, planned)

    def _counts(self) -> dict[str, int]:
        return {branch.name: len(branch.model) for branch in self.plan.train_state.branches}
