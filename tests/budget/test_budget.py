"""Runs on machines that only let a clock go on: they end in time, whatever the scene and however the speed changes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mgsr.budget.budget import TimeBudget
from mgsr.config import make_config
from mgsr.config.expert import BudgetOptions
from mgsr.data.cost_factors import CostFactors
from tests.budget.machine import Machine, Speed, run_on, steady, stepped, wavy
from tests.optional import present

USUAL = CostFactors(views=48, tests=8, pixels=256 * 256, truth=True, shiny=True)
CONFIG = make_config()
LOWEST, HIGHEST = BudgetOptions().lowest, BudgetOptions().highest
STEPS = ("start", "mesh", "evaluate", "report", "warmup_surfels", "warmup_gaussians", "mutual", "finish")


def any_scene(random: np.random.Generator) -> tuple[CostFactors, dict[str, float]]:
    """Return a scene, and by how much its steps cost more or less than is usual: up to half on real ones."""
    side = float(random.choice([64, 128, 256, 800]))
    views, tests = int(random.integers(10, 100)), int(random.integers(0, 12))
    truth, shiny, flash = (bool(random.random() < 0.5) for _ in range(3))
    factors = CostFactors(views, tests, side**2, truth, shiny, flash=shiny and flash)
    return factors, {step: float(random.uniform(0.65, 1.5)) for step in STEPS}


def least(factors: CostFactors, odd: dict[str, float], slowness: float) -> float:
    """Return the seconds of the cheapest run there is on a machine that is always so slow."""
    return run_on(Machine(steady(slowness), odd), factors, CONFIG, 1.0).seconds


def speeds(slowness: float, seconds: float, kind: str) -> Speed:
    """Return a machine at least as fast as `slowness` says."""
    if kind == "waves":
        return wavy(slowness / 1.5, seconds / 7, 0.5)
    if kind == "later slower":
        return stepped(slowness / 1.6, seconds / 3, 1.6)
    if kind == "later faster":
        return stepped(slowness, seconds / 2, 0.6)
    return steady(slowness)


@pytest.mark.parametrize("times", [1.15, 1.6, 10.0])
@pytest.mark.parametrize("seed", range(12))
def test_a_run_ends_near_its_budget(seed: int, times: float) -> None:
    random = np.random.default_rng(seed)
    factors, odd = any_scene(random)
    slowness = float(np.exp(random.uniform(-1.4, 1.4)))
    kind = ("steady", "waves", "later slower", "later faster")[seed % 4]
    seconds = times * least(factors, odd, slowness)
    ran = run_on(Machine(speeds(slowness, seconds, kind), odd), factors, CONFIG, seconds)
    assert 0.9 <= ran.seconds / seconds <= 1.05, (factors, odd, slowness, kind, ran)


def test_more_time_gives_more_of_all() -> None:
    runs = [run_on(Machine(steady(1.0)), USUAL, CONFIG, seconds) for seconds in (60, 120, 240, 400)]
    for numbers in (
        [ran.budget.place for ran in runs],
        [ran.stages[2].iteration for ran in runs],
        [ran.budget.settings.train.gaussians.max_start for ran in runs],
    ):
        steps = [present(number) for number in numbers]
        assert steps == sorted(set(steps))


def test_time_to_spare_goes_to_the_renders_since_more_training_makes_the_surface_rougher() -> None:
    ran = run_on(Machine(steady(1.0)), USUAL, CONFIG, 3000.0)
    assert ran.budget.place == pytest.approx(HIGHEST, abs=1e-2)
    high = make_config("high").train
    asked = [high.warmup.surfel_iterations, high.warmup.gaussian_iterations, high.mutual.iterations]
    assert [stage.iteration for stage in ran.stages[:3]] == asked
    assert ran.stages[3].iteration > 10 * high.mutual.iterations
    assert 0.9 <= ran.seconds / 3000 <= 1.05


@pytest.mark.parametrize(("seconds", "least", "most"), [(3000.0, 0.8, 1.25), (120.0, 0.5, 2.0)])
def test_the_last_stage_gets_the_iterations_that_were_expected(seconds: float, least: float, most: float) -> None:
    ran = run_on(Machine(steady(1.0)), USUAL, CONFIG, seconds)
    assert least <= ran.stages[3].iteration / max(1, ran.room) <= most


def test_large_photographs_are_made_smaller_only_where_time_is_short() -> None:
    large = CostFactors(views=60, tests=8, pixels=1200.0 * 1600, truth=False)
    scales = [present(run_on(Machine(steady(1.0)), large, CONFIG, seconds).budget.scale) for seconds in (60, 400, 5000)]
    assert scales[0] < scales[1] <= scales[2] == 1.0
    assert run_on(Machine(steady(1.0)), USUAL, CONFIG, 120.0).budget.scale == 1.0


def test_too_little_time_gives_the_least_plan_and_says_so() -> None:
    ran = run_on(Machine(steady(1.0)), USUAL, CONFIG, 5.0)
    assert ran.budget.too_small and ran.budget.place == pytest.approx(LOWEST, abs=1e-3)
    config = ran.budget.line.at(LOWEST)
    assert [stage.iteration for stage in ran.stages[:3]] == [
        config.train.warmup.surfel_iterations,
        config.train.warmup.gaussian_iterations,
        config.train.mutual.iterations,
    ]
    assert not run_on(Machine(steady(1.0)), USUAL, CONFIG, 2 * ran.seconds).budget.too_small


def test_stages_share_the_time_as_on_the_line() -> None:
    ran = run_on(Machine(steady(1.0)), USUAL, CONFIG, 300.0)
    planned = ran.budget.settings.train
    asked = np.array([planned.warmup.surfel_iterations, planned.warmup.gaussian_iterations, planned.mutual.iterations])
    done = np.array([stage.iteration for stage in ran.stages[:3]])
    # The uncertain share of the surface's time goes to the last stage, and the machine's steps vary by a sixth.
    assert np.ptp(np.log(done / asked)) < math.log(1.3)


def test_a_surface_that_takes_long_costs_the_last_stage_only() -> None:
    usual, slow = (run_on(Machine(steady(1.0), {"mesh": odd}), USUAL, CONFIG, 300.0) for odd in (1.0, 1.3))
    assert [stage.iteration for stage in usual.stages[:3]] == [stage.iteration for stage in slow.stages[:3]]
    assert slow.stages[3].iteration < usual.stages[3].iteration


def test_a_resumed_run_keeps_its_plan_and_its_seconds() -> None:
    ran = run_on(Machine(steady(1.0)), USUAL, CONFIG, 120.0)
    again = TimeBudget(ran.budget.line.at(1.0), lambda: 7.0)
    again.restore(ran.budget.state())
    assert again.spent == pytest.approx(ran.seconds + 7.0)
    again.take_up(USUAL)
    assert again.settings == ran.budget.settings
    assert (again.scale, again.planned, again.slowness) == (ran.budget.scale, ran.budget.planned, ran.budget.slowness)


def test_the_surface_gets_cheaper_where_the_run_is_late() -> None:
    seconds = 300.0
    planned = run_on(Machine(steady(1.0)), USUAL, CONFIG, seconds)
    late = run_on(Machine(stepped(1.0, 0.6 * seconds, 5.0)), USUAL, CONFIG, seconds)
    assert planned.mesh == planned.budget.settings.mesh
    assert late.mesh.view_scale < late.budget.settings.mesh.view_scale


def test_the_surface_is_refined_in_fewer_rounds_where_the_run_is_late() -> None:
    factors, seconds = replace(USUAL, flash=True), 300.0
    planned = run_on(Machine(steady(1.0)), factors, CONFIG, seconds)
    late = run_on(Machine(stepped(1.0, 0.5 * seconds, 2.0)), factors, CONFIG, seconds)
    assert planned.refined == 1 and 0 < late.refined < 1
    assert late.mesh == late.budget.settings.mesh and late.seconds <= 1.05 * seconds


@pytest.mark.parametrize("seconds", [80.0, 110.0, 130.0, 180.0])
def test_under_a_flash_refining_the_surface_comes_before_longer_training(seconds: float) -> None:
    factors = replace(USUAL, flash=True)
    ran = run_on(Machine(steady(1.0)), factors, CONFIG, seconds)
    whole = run_on(Machine(steady(1.0)), factors, CONFIG, 2 * seconds)
    assert 0.9 <= ran.seconds / seconds <= 1.05
    assert ran.mesh.max_light_residual is not None and 0.25 < ran.refined <= whole.refined
    if ran.refined < 1:
        draft = make_config("draft").train
        assert ran.stages[2].iteration < 1.3 * draft.mutual.iterations


def test_a_refinement_that_could_hardly_begin_is_left_out() -> None:
    factors = replace(USUAL, flash=True)
    ran = run_on(Machine(steady(1.0)), factors, CONFIG, 54.0)
    assert ran.refined == 0 and ran.mesh.max_light_residual is None and 0.9 <= ran.seconds / 54.0 <= 1.05
