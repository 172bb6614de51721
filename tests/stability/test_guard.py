"""Bad steps in training: noticed, undone, logged, and named where going back does not help."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
import torch

from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.errors import Cancelled, TrainingError
from mgsr.training import trainer
from mgsr.training.branch import Branch
from mgsr.training.control import TrainingControl
from mgsr.training.guard import Guard
from mgsr.training.plan import make_plan
from mgsr.training.run import Training
from mgsr.training.stages import Stage, Step
from mgsr.training.trainable import Trainable, step_trainables
from mgsr.training.views import TrainingView
from tests.cuda.machines import SHIM
from tests.optional import present
from tests.training.ball import ball_points, ball_scene
from tests.training.short_training import assert_same, short, tensors

QUICK = ("warmup.surfel_iterations=10", "warmup.gaussian_iterations=10", "mutual.iterations=6")


def scene() -> Scene:
    return ball_scene(24, train=4, test=1)


def first_stage(every: int = 3) -> tuple[Stage, Guard, list[str]]:
    stage = make_plan(scene(), ball_points(60), short("2dgs", *QUICK)).stages[0]
    incidents: list[str] = []
    return stage, Guard(stage, every, incidents), incidents


def step_of(stage: Stage) -> Step:
    """Return a step that is rendered and differentiated, not yet taken."""
    step = stage.compute(stage.views[0], (0.0, 0.0, 0.0), stage.iteration)
    step.loss.backward()
    return step


def values(branch: Branch[Any]) -> dict[str, torch.Tensor]:
    return {name: tensor.clone() for name, tensor in branch.tensors("values").items()}


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e25])
def test_a_bad_gradient_is_not_stepped_along(bad: float) -> None:
    stage, guard, incidents = first_stage()
    step = step_of(stage)
    assert stage.branches[0].optimizer.params["means"].grad is not None
    stage.branches[0].optimizer.params["means"].grad[3, 1] = bad
    assert not guard.admits(step, "r_0")
    assert incidents == ["warmup_surfels, iteration 0: the step on view r_0 was skipped: surfels.means not finite"]


def test_a_good_step_is() -> None:
    stage, guard, incidents = first_stage()
    step = step_of(stage)
    assert guard.admits(step, "r_0") and not incidents


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e25])
@pytest.mark.parametrize("name", ["means", "opacity_logits"])
def test_on_a_gpu_a_bad_steps_gradients_count_as_zero(name: str, bad: float) -> None:
    """Check that on a GPU a bad step's gradients count as zero.

    There nothing is read until the guard looks back; momentum goes on as after a gradient of zero.
    """
    with SHIM.running():
        stage, guard, incidents = first_stage()
        twin, _, _ = first_stage()
        for each in (stage, twin):
            step_of(each)
            step_trainables({each.branches[0]: 0.5})
        step = step_of(stage)
        (branch,), (expected,) = stage.branches, twin.branches
        present(branch.optimizer.params[name].grad).view(-1)[5] = bad
        assert guard.admits(step, "r_0") and guard.bad is not None and bool(guard.bad)
        step_trainables({branch: 0.5}, guard.bad)
        branch.gather(step.renders[0].stats, 24, 24, 1.0, guard.bad)
        for tensor in expected.optimizer.params.values():
            tensor.grad = torch.zeros_like(tensor)
        step_trainables({expected: 0.5})
        for _ in range(3):
            guard.look_back(torch.tensor(0.1))
    assert all(torch.equal(values(branch)[each], tensor) for each, tensor in values(expected).items())
    assert not branch.densify_state.gradient_sum.any() and branch.densify_state.seen.any()
    assert incidents == [
        "warmup_surfels, iteration 0: 1 of the last 3 steps were skipped, because numbers were not finite"
    ]


def test_on_a_gpu_a_good_step_is_taken() -> None:
    with SHIM.running():
        stage, guard, _ = first_stage()
        (branch,) = stage.branches
        step, before = step_of(stage), values(branch)
        assert guard.admits(step, "r_0") and not bool(guard.bad)
        step_trainables({branch: 0.5}, guard.bad)
        branch.gather(step.renders[0].stats, 24, 24, 1.0, guard.bad)
    assert all(not torch.equal(values(branch)[name], tensor) for name, tensor in before.items())
    assert branch.densify_state.gradient_sum.any()


@pytest.mark.parametrize("what", ["parameter", "loss"])
def test_the_branches_go_back_to_the_last_good_look(what: str, caplog: pytest.LogCaptureFixture) -> None:
    stage, guard, incidents = first_stage()
    (branch,) = stage.branches
    for _ in range(3):
        guard.look_back(torch.tensor(0.1))
    before, first, steps = values(branch), branch.optimizer.state_dict()["first"]["means"].clone(), branch.steps
    for _ in range(2):
        step_of(stage)
        step_trainables({branch: 0.5})
        guard.look_back(torch.tensor(0.1 if what == "parameter" else 5.0))
    if what == "parameter":
        branch.optimizer.params["means"].data[0, 0] = float("nan")
    with caplog.at_level(logging.WARNING, "mgsr.training"):
        guard.look_back(torch.tensor(0.1 if what == "parameter" else 5.0))
    assert all(torch.equal(tensor, before[name]) for name, tensor in values(branch).items())
    assert torch.equal(branch.optimizer.state_dict()["first"]["means"], first)
    assert branch.steps == steps + 2  # the schedule goes on
    expected = "surfels.means not finite" if what == "parameter" else "the loss rose from 0.1 to 5"
    assert incidents == [f"warmup_surfels, iteration 0: the last 3 steps were undone: {expected}"]
    assert incidents[0] in caplog.text


def test_what_was_kept_survives_being_gone_back_to() -> None:
    """Check that steps after a return do not change the copy that the next return needs."""
    stage, guard, _ = first_stage()
    (branch,) = stage.branches
    before = values(branch)
    for _ in range(2):
        for _ in range(3):
            step_of(stage)
            step_trainables({branch: 0.5})
            branch.optimizer.params["means"].data[0] = float("inf")
            guard.look_back(torch.tensor(0.1))
        assert all(torch.equal(tensor, before[name]) for name, tensor in values(branch).items())


def test_trouble_that_stays_is_named() -> None:
    stage, guard, _ = first_stage()
    with pytest.raises(TrainingError, match=r"iteration 0: surfels\.quats not finite again after undoing steps"):
        for _ in range(9):
            step = step_of(stage)
            assert stage.branches[0].optimizer.params["quats"].grad is not None
            stage.branches[0].optimizer.params["quats"].grad[:] = float("nan")
            guard.admits(step, "r_0")


def test_a_reset_may_raise_the_loss() -> None:
    _, guard, incidents = first_stage()
    for loss in (0.02, 0.02, 0.02):
        guard.look_back(torch.tensor(loss))
    guard.expect_anew()
    for loss in (0.8, 0.8, 0.8, 0.8, 0.8, 0.8):
        guard.look_back(torch.tensor(loss))
    assert not incidents


def test_one_bad_view_does_not_spoil_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that one view whose loss is NaN at every visit does not spoil the others.

    Training goes on from the rest, ends finite and says what it left out.
    """
    whole = TrainingView.target

    def target(view: TrainingView, background: torch.Tensor) -> object:
        made = whole(view, background)
        if view.name == "r_1":
            made.color[3, 4, 1] = float("nan")
        return made

    monkeypatch.setattr(TrainingView, "target", target)
    result = Training(scene(), ball_points(60), short("mgsr", *QUICK, "curve_every=100")).run()
    assert {text.split("view ")[1].split(" ")[0] for text in result.incidents} == {"r_1"}
    assert len(result.incidents) >= 5
    assert all(torch.isfinite(tensor).all() for tensor in tensors(result).values())


def burst_at_step_30(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a branch's thirty-first step throw every colour far off, once."""
    taken = step_trainables

    def step(progress: dict[Trainable[Any], float], bad: torch.Tensor | None = None) -> None:
        taken(progress, bad)
        for branch in progress:
            if branch.steps == 31:
                branch.optimizer.params["sh"].data.mul_(1e4)

    monkeypatch.setattr(trainer, "step_trainables", step)


def bursting() -> Config:
    return short("2dgs", "warmup.surfel_iterations=60", "mutual.iterations=20", "curve_every=1000", "report_every=1000")


def test_a_burst_in_the_parameters_is_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that a burst in the middle is undone; the training ends near one that had no such step."""
    calm = Training(scene(), ball_points(100), bursting()).run()
    burst_at_step_30(monkeypatch)
    result = Training(scene(), ball_points(100), bursting()).run()
    assert any("were undone: the loss rose" in text for text in result.incidents)
    assert present(result.curve[-1].psnr) > present(calm.curve[-1].psnr) - 2


@pytest.mark.parametrize("stop_at", [20, 35])
def test_a_resumed_run_goes_back_to_the_same_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop_at: int
) -> None:
    """Check that a resumed run undoes the burst as if nothing had stopped.

    It is stopped before the burst, or between it and the look that notices it.
    """
    burst_at_step_30(monkeypatch)
    straight = Training(scene(), ball_points(100), bursting()).run()
    path, calls = tmp_path / "checkpoint", iter(range(1000))
    with pytest.raises(Cancelled):
        Training(
            scene(), ball_points(100), bursting(), TrainingControl(None, lambda: next(calls) >= stop_at, path)
        ).run()
    resumed = Training(scene(), ball_points(100), bursting(), TrainingControl(checkpoint_path=path, resume=True)).run()
    assert len(straight.incidents) == 1 and resumed.incidents == straight.incidents
    assert_same(resumed, straight)


def test_a_training_without_trouble_has_no_incident() -> None:
    assert Training(scene(), ball_points(60), short("mgsr", *QUICK)).run().incidents == []
