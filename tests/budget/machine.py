"""A run on a machine that does nothing but let a clock go on, as fast as it likes at the time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from mgsr.budget import costs
from mgsr.budget.budget import TimeBudget
from mgsr.config import Config, MeshConfig
from mgsr.data.cost_factors import CostFactors
from mgsr.training.stage_scheduler import FINISH

Speed = Callable[[float], float]  # how many times slower than the reference machine, at a time


def steady(slowness: float) -> Speed:
    """Return a speed that is always the same."""
    return lambda _: slowness


def wavy(slowness: float, period: float, depth: float) -> Speed:
    """Return a speed that gets slower and faster by a factor of at most 1 + depth, again and again."""
    return lambda at: slowness * (1 + depth) ** math.sin(2 * math.pi * at / period)


def stepped(slowness: float, at: float, factor: float) -> Speed:
    """Return a speed that suddenly slows down by a factor, and stays so to the end."""
    return lambda now: slowness * (factor if now >= at else 1.0)


@dataclass
class Machine:
    """A machine on which work takes `speed` times its reference seconds.

    odd: by how much the steps of this scene cost more or less than is usual.
    """

    speed: Speed
    odd: dict[str, float] = field(default_factory=dict)
    seed: int = 0
    now: float = 0.0

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)

    def work(self, step: str, reference: float) -> float:
        """Do a step, and return the seconds that it took."""
        started_at, left = self.now, reference * self.odd.get(step, 1.0)
        piece = max(left / 20, 0.05)
        while left > 1e-9:
            done = min(piece, left)
            self.now += done * self.speed(self.now) * self.random.lognormal(0.0, 0.15)
            left -= done
        return self.now - started_at


@dataclass
class Stage:
    """A stage as the trainer has it."""

    name: str
    iterations: int
    iteration: int = 0


@dataclass(frozen=True)
class Ran:
    """The course of a run.

    Its seconds, its budget, its stages, the settings of its surface, the share of the rounds of refinement that this
    had, and the iterations that the budget expected of the last stage.
    """

    seconds: float
    budget: TimeBudget
    stages: list[Stage]
    mesh: MeshConfig
    refined: float
    room: int


def run_on(machine: Machine, factors: CostFactors, config: Config, seconds: float) -> Ran:
    """Take the steps of `mgsr.pipeline.run.run_scene`, in its order, as far as the budget sees them."""
    budget = TimeBudget(replace(config, time_budget=seconds), lambda: machine.now)
    machine.now += 0.5 * machine.speed(0.0)  # imports
    budget.learn(costs.load_cost(factors), machine.work("load", costs.load_cost(factors)))
    scale = budget.choose_scale(factors)
    factors = replace(factors, pixels=factors.pixels * scale**2)
    start = costs.start_cost(factors, budget.stereo_pixels)
    budget.learn(start, machine.work("start", start))
    splats = {"surfels": config.train.surfels.max_start, "gaussians": config.train.gaussians.max_start}
    names = ("warmup_surfels", "warmup_gaussians", "mutual")
    once = {name: machine.work(name, costs.iteration_cost(name, factors, splats)) for name in names}
    budget.choose_place(factors, once, splats)
    train = budget.settings.train
    lengths = (train.warmup.surfel_iterations, train.warmup.gaussian_iterations, train.mutual.iterations)
    stages = [*(Stage(*pair) for pair in zip(names, lengths, strict=True)), Stage(FINISH, 0)]
    full = {
        "surfels": costs.usual_settings(factors, budget.settings)[0].densify.max_count,
        "gaussians": costs.usual_count(train.gaussians.max_start, factors),
    }
    for index in range(3):
        _run_stage(machine, budget, stages, index, factors, full)
    mesh = budget.mesh_settings()
    surface = machine.work("mesh", costs.surface_cost(factors, mesh))
    rounds = 15 if factors.flash else 4  # that the steps of `mgsr.mesh.steps` ask for
    done = 0
    while mesh.max_light_residual is not None and done < rounds and budget.go_on():
        surface += machine.work("mesh", costs.refinement_cost(factors, mesh) / rounds)
        done += 1
    judging = machine.work("evaluate", costs.judging_cost(factors))
    budget.learn_surface(surface, judging)
    room = budget.room(full)
    _run_stage(machine, budget, stages, 3, factors, full)
    machine.work("report", costs.closing_cost(factors))
    return Ran(machine.now, budget, stages, mesh, done / rounds, room)


def _run_stage(
    machine: Machine, budget: TimeBudget, stages: list[Stage], index: int, factors: CostFactors, splats: dict[str, int]
) -> None:
    stage = stages[index]
    stage.iterations = budget.length(stages, index, splats)
    while stage.iteration < stage.iterations:
        # The budget looks at the clock after as many only, unless the stage is about to end.
        period = budget.options.period
        at_once = period if stage.iterations - stage.iteration > 2 * period else 1
        machine.work(stage.name, at_once * costs.iteration_cost(stage.name, factors, splats))
        stage.iteration += at_once
        if stage.iteration < stage.iterations:
            stage.iterations = budget.length(stages, index, splats)
