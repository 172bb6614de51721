"""The use of `TimeBudget` by a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mgsr.budget.budget import TimeBudget
from mgsr.budget.costs import cameras_cost, load_cost, start_cost
from mgsr.config import PRESETS, Config, ExpertConfig, Object
from mgsr.data.cost_factors import CostFactors
from mgsr.data.find_cameras import PHOTOGRAPHS
from mgsr.data.loading import reduced_view
from mgsr.data.scene import Scene
from mgsr.metrics.truth import TRUTH
from mgsr.pipeline.device import Device
from mgsr.pipeline.steps import StepClock
from mgsr.report.data import BudgetFacts
from mgsr.start.points import StartingPoints
from mgsr.training.checkpoint import read_schedule
from mgsr.training.probe import probe


def make_budget(
    config: Config, clock: Callable[[], float], device: Device, checkpoint: Path | None
) -> TimeBudget | None:
    """Build the budget that the settings ask for; it continues the budget of a checkpoint, if there is one."""
    if config.time_budget is None:
        return None
    budget = TimeBudget(config, clock, on_gpu=device is not Device.CPU)
    state = None if checkpoint is None else read_schedule(checkpoint)
    if state is not None:
        budget.restore(state)
    return budget


def cost_factors(scene: Scene, config: Config, start: StartingPoints | None = None) -> CostFactors:
    """Return the cost factors of a scene.

    Without starting points, the factors that depend on them assume the costlier case.
    """
    cameras = [view.camera for view in scene.train]
    pixels = sum(camera.width * camera.height for camera in cameras) / max(1, len(cameras))
    shiny = flash = True
    if start is not None and start.shiny is not None:
        shiny, flash = start.shiny, start.lighting is not None
    truth, learned = (scene.root / TRUTH).is_file(), scene.backdrop(config.train.background).plain
    searched = searches_object(scene, config)
    area = None if start is None else start.surface_pixels
    return CostFactors(
        len(cameras), len(scene.test), pixels, truth, shiny, scene.masked, learned, flash, searched, area
    )


def searches_object(scene: Scene, config: Config) -> bool:
    """Return whether a run looks for an object in the scene: the settings ask for it, and no masks were read."""
    asked = config.data.object is Object.AUTO or config.data.object_box is not None
    return asked and not scene.masked and not scene.backdrop(config.train.background).plain


def learn_search(scene: Scene, budget: TimeBudget, clock: StepClock) -> None:
    """Calibrate the budget to this machine's speed by the time of a complete search for cameras, if there was one."""
    if "cameras" in clock.steps and scene.format == PHOTOGRAPHS:
        views = [*scene.train, *scene.test]
        pixels = sum(view.camera.width * view.camera.height for view in views) / len(views)
        budget.learn(cameras_cost(len(views), pixels, frames=False), clock.steps["cameras"])


def fitted_scene(scene: Scene, budget: TimeBudget, config: Config, clock: StepClock) -> Scene:
    """Reduce the training views of a scene to the size that the budget allows; the test views are unchanged.

    clock: gives the reading time of the photographs.
    """
    factors = cost_factors(scene, config)
    if "load" in clock.steps:
        budget.learn(load_cost(factors), clock.steps["load"])
    scale = budget.choose_scale(factors) if budget.scale is None else budget.scale
    if scale == 1:
        return scene
    return replace(scene, train=[reduced_view(view, scale) for view in scene.train])


def most_points(config: Config, budget: TimeBudget | None) -> int:
    """Return the largest useful number of starting points."""
    settings = config if budget is None else budget.line.at(config.expert.budget.highest)
    return max(settings.train.surfels.max_start, settings.train.gaussians.max_start)


def affordable_options(config: Config, budget: TimeBudget | None) -> ExpertConfig:
    """Return the options of the algorithms, with the stereo of whole scenes reduced to what the budget affords."""
    if budget is None:
        return config.expert
    start = config.expert.start
    return replace(config.expert, start=replace(start, stereo=replace(start.stereo, max_pixels=budget.stereo_pixels)))


def planned_config(
    scene: Scene, start: StartingPoints, budget: TimeBudget, config: Config, device: Device, clock: StepClock
) -> Config:
    """Choose the settings that fit the remaining time.

    clock: gives the duration of the choice of starting points. Raises the errors of training.
    """
    factors = replace(cost_factors(scene, config, start), searched="object" in clock.steps)
    budget.learn(
        start_cost(factors, budget.stereo_pixels),
        sum(clock.steps.get(name, 0.0) for name in ("start", "learned_masks", "object", "background")),
    )
    if budget.place is None:
        probed = probe(scene, start, config, device.torch)
        budget.choose_place(factors, probed.seconds, probed.splats)
    else:
        budget.take_up(factors)
    return budget.settings


def plan_line(budget: TimeBudget) -> str:
    """Summarise the plan in one line."""
    assert budget.place is not None
    words = f"{budget.seconds:g} s: settings {place_words(budget.place)}"
    if budget.scale != 1:
        words += f", photographs reduced to {budget.scale:g} of their size"
    words += f", {budget.planned['train']:.0f} s of training, {budget.planned['mesh']:.0f} s for the surface"
    if budget.too_small:
        words += f"; that is too little, and the shortest plan may take {budget.least:.0f} s"
    return words


def place_words(place: float) -> str:
    """Describe a place on the line of settings by the presets around it."""
    names = list(PRESETS)
    below = int(place // 1)
    if below < 0:
        return f"below {names[0]} ({place:.2f})"
    if below >= len(names) - 1:
        return f"of {names[-1]} and more ({place:.2f})"
    return f"between {names[below]} and {names[below + 1]} ({place:.2f})"


def budget_facts(budget: TimeBudget, steps: dict[str, float]) -> BudgetFacts:
    """Return the facts of the budget for report.json. steps: the seconds spent, by step."""
    return BudgetFacts(
        seconds=budget.seconds,
        used=budget.spent,
        place=budget.place,
        settings=place_words(budget.place or 0.0),
        image_scale=budget.scale or 1.0,
        too_small=budget.too_small,
        planned=budget.planned,
        spent=dict(steps),
    )
