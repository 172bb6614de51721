"""A proxy model: a small 3D branch, trained on small photographs to learn something before the real training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import Reflection, make_config
from mgsr.config.expert import ProxyModelOptions
from mgsr.data.backdrop import Color
from mgsr.data.loading import reduced_view
from mgsr.data.scene import Scene, View
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.start.points import StartingPoints
from mgsr.start.view_colors import median_colors
from mgsr.training.control import TrainingControl
from mgsr.training.plan import Plan
from mgsr.training.stages import Stage, Step, gaussians_alone
from mgsr.training.train_state import make_train_state, seeded
from mgsr.training.trainer import Trainer
from mgsr.training.views import CPU, TrainingView, ViewCycle, prepare_views


@dataclass(frozen=True)
class ProxyTraining:
    """The training of a proxy model.

    stage: the stage's name.
    degree: the degree of the colours' harmonics.
    opacity_cost: the weight of the mean opacity in the loss, which removes superfluous Gaussians.
    """

    stage: str
    degree: int
    iterations: int
    seed: int
    options: ProxyModelOptions = ProxyModelOptions()
    opacity_cost: float = 0.0


def small_view(view: View, side: int = ProxyModelOptions().side) -> View:
    """Reduce a view to the size that a proxy model is trained on: at most `side` pixels along its longer side."""
    return reduced_view(view, min(1.0, side / max(view.camera.width, view.camera.height)))


def train_proxy_model(
    scene: Scene,
    start: StartingPoints,
    views: list[View],
    training: ProxyTraining,
    should_stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda done: None,
) -> GaussianModel:
    """Train a proxy model: some of the starting points as Gaussians, on small views of the scene.

    No Gaussian is added or dropped. The same seed gives the same Gaussians.

    progress: called with the completed share, 0..1.

    Raises Cancelled once should_stop returns True, and TrainingError if training fails.
    """
    kind = ["branches=gaussians", "reflection=off", f"gaussians.sh_degree={training.degree}", "tv=off"]
    settings = make_config(seed=training.seed, overrides=[*kind, "gaussians.densify.by=gradient"])
    few = _few(start, views, training.seed, training.options.points)
    train_state = make_train_state(replace(scene, train=views), few, settings, Reflection.OFF, False, CPU)
    branch = train_state.gaussians
    assert branch is not None
    cycle = ViewCycle(len(views), seeded(settings, 7))
    see = gaussians_alone(branch, settings.train, warming=False)

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        step = see(view, background, iteration)
        if not training.opacity_cost:
            return step
        return replace(step, loss=step.loss.plus("opacity", training.opacity_cost * branch.model.opacities().mean()))

    prepared, rates = prepare_views(views, scene.masked), training.options.rates
    last = training.iterations
    stage = Stage(training.stage, [branch], last, prepared, cycle, compute, lambda _: (1, 0), lambda *_: rates)
    plan = Plan(train_state, [stage], [], scene.backdrop(settings.train.background))
    Trainer(plan, settings.train, {}, TrainingControl(lambda report: progress(report.done), should_stop)).run()
    return branch.model


def _few(start: StartingPoints, views: Sequence[View], seed: int, count: int) -> StartingPoints:
    """Draw some of the starting points, and take their colours from some of the views."""
    rows = np.sort(np.random.default_rng(seed).permutation(len(start.positions))[:count])
    positions = start.positions[rows]
    normals = None if start.normals is None else start.normals[rows]
    return StartingPoints(positions, median_colors(views, positions, normals), start.source, normals)
