"""Model selection of what the 3D branch adds to the transmitted light."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from mgsr.config import Reflection, make_config
from mgsr.errors import Cancelled
from mgsr.training.control import TrainingControl
from mgsr.training.model_selection import CANDIDATES, Candidate, ReflectionSelection, simplest
from mgsr.training.plan import make_plan
from mgsr.training.progress import Progress, TrainResult
from mgsr.training.run import Training
from mgsr.training.trainable import step_trainables
from tests.training.ball import RADIUS, ball_points, ball_scene

LENGTHS = [
    "surfel_iterations=100",
    "gaussian_iterations=240",
    "mutual.iterations=40",
    "stop_rule=none",
]
TRIED = [
    "model_selection.iterations=100",
    "model_selection.views=3",
    "environment_map.side=16",
    "model_selection.start=0.5",
    "gaussians.sh_degree=2",
]


def trained(gloss: float, method: str = "mgsr", *overrides: str, **control: Any) -> TrainResult:
    scene = ball_scene(32, train=14, test=3, gloss=gloss)
    config = make_config("draft", method, 0, [*LENGTHS, *TRIED, *overrides])
    return Training(scene, ball_points(600, RADIUS), config, TrainingControl(**control)).run()


def test_a_matte_ball_ends_without_reflection() -> None:
    result = trained(0.0)
    assert result.model.reflection is Reflection.OFF
    assert result.model.gaussians is not None
    assert result.model.environment_map is None and not result.model.gaussians.split
    assert list(result.tried) == ["off", "shared"]


@pytest.mark.slow
def test_colours_that_do_not_change_with_the_direction_need_no_harmonics() -> None:
    result = trained(0.0)
    assert list(result.degrees) == [1, 0]
    assert result.tried["off"] <= result.degrees[1] <= result.degrees[0]
    assert result.model.gaussians is not None and result.model.surfels is not None
    assert result.model.gaussians.sh_degree == 0 and result.model.surfels.sh_degree == 2


@pytest.mark.parametrize(
    ("reached", "kept", "degrees"),
    [
        ([30.0, 30.0, 29.8], 2, {1: 29.8}),
        ([30.0, 30.0, 30.2, 30.1], 1, {1: 30.2, 0: 30.1}),
        ([29.0, 30.0, 30.0, 30.05], 0, {1: 30.0, 0: 30.05}),
    ],
)
def test_harmonics_are_dropped_degree_by_degree(reached: list[float], kept: int, degrees: dict[int, float]) -> None:
    plan = make_plan(ball_scene(32, train=14, test=3), ball_points(), make_config("draft", "mgsr", 0, TRIED))
    names: list[str] = []
    stage, values = plan.stages[1], iter(reached)
    assert isinstance(stage.selection, ReflectionSelection)
    stage.selection.measure = lambda: next(values)
    stage.selection.run(stage, lambda name, iterations: names.append(name))
    assert names == ["off", "shared", *(f"degree_{degree}" for degree in degrees)]
    assert plan.train_state.gaussians is not None
    assert plan.train_state.gaussians.model.sh_degree == kept and stage.selection.degrees == degrees


def test_under_a_flash_a_ball_ends_with_the_light_that_all_splats_share() -> None:
    result = trained(0.6)
    assert result.tried["shared"] > result.tried["off"] + 0.1
    assert result.model.reflection is Reflection.SHARED
    assert result.model.gaussians is not None
    assert result.model.environment_map is not None and not result.model.gaussians.split


def test_without_a_surface_splats_can_only_have_their_own() -> None:
    result = trained(0.6, "mgsr", "branches=gaussians")
    assert list(result.tried) == ["off", "own"]


def test_what_was_asked_for_is_not_tried() -> None:
    result = trained(0.0, "mgsr", "reflection=both")
    assert result.model.reflection is Reflection.BOTH and not result.tried
    assert trained(0.6, "3dgs").model.reflection is Reflection.OFF


def test_too_few_photographs_are_not_held_back() -> None:
    """Check that three photographs are too few to spare one: then the start's word counts, and it had none."""
    scene = ball_scene(32, train=3, test=1)
    result = Training(scene, ball_points(600, RADIUS), make_config("draft", "mgsr", 0, [*LENGTHS, *TRIED])).run()
    assert result.model.reflection is Reflection.BOTH and not result.tried


def test_model_selection_reports_itself() -> None:
    reports: list[Progress] = []
    trained(0.0, progress=reports.append)
    names = list(dict.fromkeys(report.stage for report in reports))
    candidates = ["selection_off", "selection_shared", "selection_degree_1", "selection_degree_0"]
    assert names == ["warmup_surfels", "warmup_gaussians", *candidates, "mutual"]
    assert [report.done for report in reports] == sorted(report.done for report in reports)


def test_model_selection_stops_on_request() -> None:
    reports: list[Progress] = []
    with pytest.raises(Cancelled, match="stopped on request while model selection trained off"):
        trained(
            0.0, progress=reports.append, should_stop=lambda: bool(reports) and reports[-1].stage == "selection_off"
        )


def test_views_held_back_are_trained_on_afterwards() -> None:
    config = make_config("draft", "mgsr", 0, [*LENGTHS, *TRIED])
    plan = make_plan(ball_scene(32, train=14, test=3), ball_points(), config)
    stage = plan.stages[1]
    assert (len(stage.views), stage.cycle.count) == (14, 11)
    stage.iteration = 120
    assert stage.selection is not None
    stage.selection.run(stage, lambda reflection, iterations: None)
    assert stage.cycle.count == 14 and not stage.selection.due(stage)


def test_narrowing_keeps_what_the_optimiser_knows_of_the_rest() -> None:
    branch = make_plan(ball_scene(32, train=14, test=3), ball_points(), make_config("draft")).train_state.gaussians
    assert branch is not None
    for tensor in branch.optimizer.params.values():
        tensor.grad = torch.rand_like(tensor)
    step_trainables({branch: 0.0})
    values, before = branch.model.sh.detach().clone(), branch.optimizer.state_dict()
    branch.narrow("sh", 4)
    after = branch.optimizer.state_dict()
    assert branch.model.sh_degree == 1 and torch.equal(branch.model.sh, values[:, :4])
    for kind in ("first", "second"):
        assert torch.equal(after[kind]["sh"], before[kind]["sh"][:, :4])
        assert torch.equal(after[kind]["means"], before[kind]["means"])
    branch.optimizer.params["sh"].grad = torch.ones_like(branch.model.sh)
    step_trainables({branch: 0.0})
    assert not torch.equal(branch.model.sh, values[:, :4])


def test_widening_keeps_what_the_optimiser_knows() -> None:
    config = make_config("draft", "mgsr", 0, [*LENGTHS, *TRIED])
    branch = make_plan(ball_scene(32, train=14, test=3), ball_points(), config).train_state.gaussians
    assert branch is not None
    for tensor in branch.tensors("values").values():
        tensor.grad = None
    for tensor in branch.optimizer.params.values():
        tensor.grad = torch.ones_like(tensor)
    step_trainables({branch: 0.0})
    before = branch.optimizer.state_dict()
    branch.widen({"weight_logits": torch.zeros(len(branch.model))})
    after = branch.optimizer.state_dict()
    assert torch.equal(after["first"]["means"], before["first"]["means"])
    assert after["steps"]["means"] == 1 and after["steps"]["weight_logits"] == 0
    assert not after["second"]["weight_logits"].any()
    assert branch.model.weight_logits is branch.optimizer.params["weight_logits"]


@pytest.mark.parametrize(
    ("psnr", "chosen"),
    [((30.0, 30.08), 0), ((30.0, 30.2), 1), ((30.0, 29.0), 0)],
)
def test_the_simplest_of_those_as_good_as_the_best(psnr: tuple[float, ...], chosen: int) -> None:
    tried = [Candidate(kind, 2, value, {}) for kind, value in zip(CANDIDATES, psnr, strict=True)]
    assert simplest(tried, gain=0.1) is tried[chosen]
