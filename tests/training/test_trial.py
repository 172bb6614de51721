"""The trial of what the 3D branch adds to the transmitted light."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from mgsr.config import Reflection, make_config
from mgsr.errors import Cancelled
from mgsr.training.plan import make_plan
from mgsr.training.progress import Progress, TrainResult
from mgsr.training.run import Training
from mgsr.training.trial import Candidate, simplest
from tests.training.ball import RADIUS, ball_points, ball_scene

LENGTHS = ["surfel_iterations=100", "volume_iterations=240", "mutual.iterations=40", "stop_rule=none"]
TRIED = ["trial.iterations=100", "trial.views=3", "mirror.side=16", "trial.start=0.5"]


def trained(gloss: float, method: str = "mgsr", *overrides: str, **callbacks: Any) -> TrainResult:
    scene = ball_scene(32, train=14, test=3, gloss=gloss)
    return Training(
        scene, ball_points(600, RADIUS), make_config("draft", method, 0, [*LENGTHS, *TRIED, *overrides]), **callbacks
    ).run()


def test_a_matte_ball_ends_without_reflection() -> None:
    result = trained(0.0)
    assert result.reflection is Reflection.OFF
    assert result.light is None and not result.volumes.split
    assert list(result.tried) == ["off", "shared", "both"]


def test_under_a_flash_a_ball_ends_with_the_light_that_all_splats_share() -> None:
    result = trained(0.6)
    assert result.tried["shared"] > result.tried["off"] + 0.1
    assert result.reflection is Reflection.SHARED
    assert result.light is not None and not result.volumes.split


def test_without_a_surface_splats_can_only_have_their_own() -> None:
    result = trained(0.6, "mgsr", "branches=volumes")
    assert list(result.tried) == ["off", "own"]


def test_what_was_asked_for_is_not_tried() -> None:
    result = trained(0.0, "mgsr", "reflection=both")
    assert result.reflection is Reflection.BOTH and not result.tried
    assert trained(0.6, "3dgs").reflection is Reflection.OFF


def test_too_few_photographs_are_not_held_back() -> None:
    """Three of them are too few to spare one: then the start's word counts, and it had none."""
    scene = ball_scene(32, train=3, test=1)
    result = Training(scene, ball_points(600, RADIUS), make_config("draft", "mgsr", 0, [*LENGTHS, *TRIED])).run()
    assert result.reflection is Reflection.BOTH and not result.tried


def test_the_trial_reports_itself() -> None:
    reports: list[Progress] = []
    trained(0.0, progress=reports.append)
    names = list(dict.fromkeys(report.stage for report in reports))
    assert names == ["warmup_surfels", "warmup_volumes", "trial_off", "trial_shared", "trial_both", "mutual"]
    assert [report.done for report in reports] == sorted(report.done for report in reports)


def test_a_trial_heeds_the_wish_to_stop() -> None:
    reports: list[Progress] = []
    with pytest.raises(Cancelled, match="off was tried"):
        trained(0.0, progress=reports.append, should_stop=lambda: bool(reports) and reports[-1].stage == "trial_off")


def test_views_held_back_are_trained_on_afterwards() -> None:
    config = make_config("draft", "mgsr", 0, [*LENGTHS, *TRIED])
    plan = make_plan(ball_scene(32, train=14, test=3), ball_points(), config)
    stage = plan.stages[1]
    assert (len(stage.views), stage.cycle.count) == (14, 11)
    stage.iteration = 120
    stage.trial.hold(stage, lambda reflection, iterations: None)
    assert stage.cycle.count == 14 and not stage.trial.due(stage)


def test_widening_keeps_what_the_optimiser_knows() -> None:
    config = make_config("draft", "mgsr", 0, [*LENGTHS, *TRIED])
    branch = make_plan(ball_scene(32, train=14, test=3), ball_points(), config).parts.volumes
    for tensor in branch.tensors("values").values():
        tensor.grad = None
    for tensor in branch.optimizer.params.values():
        tensor.grad = torch.ones_like(tensor)
    branch.step(0.0)
    before = branch.optimizer.state_dict()
    branch.widen({"weight_logits": torch.zeros(len(branch.model))})
    after = branch.optimizer.state_dict()
    assert torch.equal(after["first"]["means"], before["first"]["means"])
    assert after["steps"]["means"] == 1 and after["steps"]["weight_logits"] == 0
    assert not after["second"]["weight_logits"].any()
    assert branch.model.weight_logits is branch.optimizer.params["weight_logits"]


@pytest.mark.parametrize(
    ("psnr", "chosen"),
    [((30.0, 30.08, 30.08), 0), ((30.0, 30.2, 30.28), 1), ((30.0, 30.2, 30.4), 2), ((30, 29, 30), 0)],
)
def test_the_simplest_of_those_as_good_as_the_best(psnr: tuple[float, ...], chosen: int) -> None:
    kinds = (Reflection.OFF, Reflection.SHARED, Reflection.BOTH)
    tried = [Candidate(kind, value, {}) for kind, value in zip(kinds, psnr, strict=True)]
    assert simplest(tried, gain=0.1) is tried[chosen]
