"""A proxy model: a small 3D branch, trained on small photographs to learn something before the real training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mgsr.config import Reflection, make_config
from mgsr.config.expert import ProxyModelOptions
from mgsr.data.backdrop import Color
from mgsr.data.loading import reduced_view
from mgsr.data.scene import Scene, View
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.start.points import StartingPoints
from mgsr.start.view_colors import median_colors
from mgsr.training.plan import Plan
from mgsr.training.stages import Stage, Step, gaussians_alone
from mgsr.training.train_state import make_train_state, seeded
from mgsr.training.trainer import Trainer
from mgsr.training.views import CPU, TrainingView, ViewCycle, prepare_views


def small_view(view: View, side: int = ProxyModelOptions().side) -> View:
    """Reduce a view to the size that a proxy model is trained on: at most `side` pixels along its longer side."""
    return reduced_view(view, min(1.0, side / max(view.camera.width, view.camera.height)))


def train_proxy_model(
    scene: Scene,
    start: StartingPoints,
    views: list[View],
    degree: int,
    iterations: int,
    seed: int,
    name: str,
    should_stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda done: None,
    opacity_cost: float = 0.0,
    options: ProxyModelOptions = ProxyModelOptions(),
) -> GaussianModel:
    """Train a proxy model: some of the starting points as Gaussians, on small views of the scene.

    No Gaussian is added or dropped. The same seed gives the same Gaussians.

    degree: the degree of the colours' harmonics.
    name: the stage's name.
    progress: called with the completed share, 0..1.
    opacity_cost: the weight of the mean opacity in the loss, which removes superfluous Gaussians.

    Raises Cancelled once should_stop returns True, and TrainingError if training fails.
    """
    kind = ["branches=gaussians", "reflection=off", f"gaussians.sh_degree={degree}", "tv=off"]
    settings = make_config(seed=seed, overrides=[*kind, "gaussians.densify.by=gradient"])
    train_state = make_train_state(
        replace(scene, train=views), _few(start, views, seed, options.points), settings, Reflection.OFF, False, CPU
    )
    branch = train_state.gaussians
    assert branch is not None
    cycle = ViewCycle(len(views), seeded(settings, 7))
    see = gaussians_alone(branch, settings.train, warming=False)

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        step = see(view, background, iteration)
        if not opacity_cost:
            return step
        return replace(step, loss=step.loss.plus("opacity", opacity_cost * branch.model.opacities().mean()))

    prepared = prepare_views(views, scene.masked)
    stage = Stage(name, [branch], iterations, prepared, cycle, compute, lambda _: (1, 0), lambda *_: options.rates)
    plan = Plan(train_state, [stage], [], scene.backdrop(settings.train.background))
    Trainer(plan, settings.train, {}, should_stop=should_stop, progress=lambda report: progress(report.done)).run()
    return branch.model


def _few(start: StartingPoints, views: Sequence[View], seed: int, count: int) -> StartingPoints:
    """Draw some of the starting points, and take their colours from some of the views."""
    rows = np.sort(np.random.default_rng(seed).permutation(len(start.positions))[:count])
    positions = start.positions[rows]
    normals = None if start.normals is None else start.normals[rows]
    return StartingPoints(positions, median_colors(views, positions, normals), start.source, normals)
