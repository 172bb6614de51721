"""The plan of a run: its stages, built from the settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import torch

from mgsr.config import Branches, Config, DensifyConfig, Growth, Reflection, StopRule, starting_settings
from mgsr.data.backdrop import Backdrop, Color
from mgsr.data.scene import Scene
from mgsr.densify.clearance import Clearance
from mgsr.densify.contribution import contributions, largest_contributions, least_contributing
from mgsr.errors import TrainingError
from mgsr.gaussians.reflector import Reflector
from mgsr.gaussians.surfels import SurfelModel
from mgsr.start.points import StartingPoints
from mgsr.training.branch import Branch
from mgsr.training.convergence import make_convergence
from mgsr.training.evaluate import mean_psnr
from mgsr.training.growth import ErrorGrowth
from mgsr.training.model_selection import ReflectionSelection
from mgsr.training.stage_scheduler import FINISH
from mgsr.training.stages import (
    Coarse,
    ModelSelection,
    ReflectingSurface,
    Stage,
    Step,
    both_teach,
    gaussians_alone,
    surfels_alone,
)
from mgsr.training.train_state import TrainState, make_train_state, seeded
from mgsr.training.trainable import Trainable
from mgsr.training.views import CPU, TrainingView, ViewCycle, prepare_views

T = TypeVar("T")


@dataclass(frozen=True)
class Plan:
    """A run before its first iteration.

    train_state: the branches and maps to train.
    stages: the stages in their order.
    curve_views: the views that only the error curve uses.
    backdrop: the background behind the splats.
    """

    train_state: TrainState
    stages: list[Stage]
    curve_views: list[TrainingView]
    backdrop: Backdrop

    @property
    def selection(self) -> ModelSelection | None:
        """Return the model selection of the 3D branch; None where there is none."""
        return next((stage.selection for stage in self.stages if stage.selection is not None), None)

    def set_reflector(self, reflector: Reflector) -> bool:
        """Let a mesh reflect the environment map from the stage FINISH on, and return whether it does.

        The mesh reflects the map only if the map is used and masks outline the object.
        """
        finish, light = self.stages[-1], self.train_state.environment_map
        if finish.name != FINISH or light is None or not (light.used and light.settings.iterations):
            return False
        if any(view.mask is None for view in finish.views):
            return False
        reflector.prepare((view.camera for view in finish.views), light.device)
        light.model.reflector = reflector
        for part in finish.trainables:
            part.rate_scale = light.settings.finish_rates
        finish.iterations = light.settings.iterations
        return True


@dataclass(frozen=True)
class _Photographs:
    """A stage's views, and reduced copies of them where they are large enough.

    The last `held_out` of both are held out of training. behind: the colour behind renderings that are compared.
    """

    views: list[TrainingView]
    small: list[TrainingView] | None
    behind: Color
    held_out: int = 0

    @property
    def trained_on(self) -> int:
        return len(self.views) - self.held_out

    def sparing(self, count: int) -> _Photographs:
        """Return the same photographs with `count` of them, evenly spaced, held out of the stage."""
        spared = _spread(range(len(self.views)), count)
        order = [i for i in range(len(self.views)) if i not in spared] + spared
        small = None if self.small is None else [self.small[i] for i in order]
        return _Photographs([self.views[i] for i in order], small, self.behind, count)


def make_plan(
    scene: Scene, start: StartingPoints, config: Config, device: torch.device = CPU, finish: bool = False
) -> Plan:
    """Build the branches on the starting points, all on `device`, and the stages that the settings ask for.

    With `finish`, or where a mesh may reflect the environment map, one more stage follows. It trains the rendering
    branch alone, and its length is zero until it is set.

    Raises TrainingError for too few training views.
    """
    if len(scene.train) < 2:
        raise TrainingError(f"scene {scene.name}: expected at least 2 training views, got {len(scene.train)}")
    behind = scene.backdrop(config.train.background)
    photographs = _photographs(scene, behind.color, config, device)
    reflection, tried = _first_reflection(config, start.shiny, len(scene.train))
    train_state = make_train_state(scene, start, config, reflection, tried, device)
    _, gaussians = starting_settings(config.train, scene.masked, len(start.positions))
    growth = None
    if train_state.gaussians is not None and gaussians.densify.by is Growth.ERROR:
        options = config.expert.densify.error_growth
        growth = ErrorGrowth(train_state.gaussians, train_state, gaussians, behind.color, options)
    stages: list[Stage] = []
    last = _last_stage(train_state, photographs.views, stages, config)
    last.growth = growth
    clearance = None
    if not scene.masked and config.train.clearance:
        cameras = [view.camera for view in scene.train]
        share, rank = config.train.clearance, config.expert.densify.clearance_rank
        clearance = Clearance.around(cameras, start.positions, share, rank)
    if train_state.surfels is not None:
        stages.append(_surfel_warmup(train_state, photographs, last, config))
    if train_state.gaussians is not None:
        stages.append(_gaussian_warmup(train_state, photographs, last, config, tried))
        stages[-1].growth = growth
    stages.append(last)
    for stage in stages:
        stage.clearance = clearance
    if finish or (train_state.environment_map is not None and scene.masked and config.train.environment_map.iterations):
        stages.append(_finish(train_state, photographs.views, config))
    curve_views = prepare_views(_spread(scene.test, config.train.watch.curve_views), scene.masked, device=device)
    return Plan(train_state, stages, curve_views, behind)


def mutual_iterations(config: Config) -> int:
    """Return the iterations of the mutual phase, or of a lone branch in its place."""
    return round(config.train.mutual.iterations * config.train.paper.iterations_factor)


def _first_reflection(config: Config, shiny: bool | None, views: int) -> tuple[Reflection, bool]:
    """Return the 3D branch's initial reflection model, and whether model selection may change it."""
    asked, alone = config.train.gaussians.reflection, config.train.branches is Branches.GAUSSIANS
    if asked is not Reflection.AUTO:
        return asked, False
    if config.train.model_selection.iterations and _spared(config, views):
        return Reflection.OFF, True
    if shiny is False:
        return Reflection.OFF, False
    return Reflection.OWN if alone else Reflection.SHARED if shiny else Reflection.BOTH, False


def _photographs(scene: Scene, behind: Color, config: Config, device: torch.device) -> _Photographs:
    train, margin = config.train, config.train.crop_margin
    views = prepare_views(scene.train, scene.masked, margin, train.surfels.edge_band, device)
    shortest = min(min(view.whole) for view in views)
    if not train.warmup.coarse or shortest < train.warmup.coarse_side:
        return _Photographs(views, None, behind)
    band = -(-train.surfels.edge_band // 2)
    return _Photographs(views, prepare_views(scene.train, scene.masked, margin, band, device, reduce=2), behind)


def _surfel_warmup(train_state: TrainState, photographs: _Photographs, last: Stage, config: Config) -> Stage:
    assert train_state.surfels is not None
    photographs = photographs.sparing(_validation_views(config, len(photographs.views)))
    compute = surfels_alone(train_state.surfels, config.train, warming=True)
    return _warmup("warmup_surfels", train_state, train_state.surfels, compute, photographs, last, config)


def _gaussian_warmup(
    train_state: TrainState, photographs: _Photographs, last: Stage, config: Config, tried: bool
) -> Stage:
    assert train_state.gaussians is not None
    views = len(photographs.views)
    held_out = _validation_views(config, views)
    photographs = photographs.sparing(max(held_out, _spared(config, views) if tried else 0))
    surface = None
    if train_state.environment_map is not None and train_state.surfels is not None:
        surface = ReflectingSurface(train_state.environment_map, train_state.surfels)
    compute = gaussians_alone(train_state.gaussians, config.train, warming=True, surface=surface)
    stage = _warmup("warmup_gaussians", train_state, train_state.gaussians, compute, photographs, last, config)
    if tried:
        measure = _measure(train_state, "gaussians", photographs)
        seen_after = views - held_out
        stage.selection = ReflectionSelection(
            config.train, train_state.gaussians, train_state.environment_map, measure, seen_after
        )
    return stage


def _pruning(branch: Branch[Any], views: list[TrainingView]) -> Callable[[], int]:
    """Return a function that prunes the splats of least contribution from a branch, and returns their number.

    Together they contribute less than the share that the branch's settings give. Of a surfel, the photograph with the
    largest contribution counts: the surface matters wherever one photograph shows it.
    """
    share = branch.densify.prune_contribution

    def prune() -> int:
        if not share or any(view.mask is None for view in views):
            return 0
        measure = largest_contributions if isinstance(branch.model, SurfelModel) else contributions
        each = measure(branch.model, [view.camera for view in views])
        kept = (~least_contributing(each, share)).nonzero().squeeze(1)
        dropped = len(branch.model) - len(kept)
        branch.keep(kept)
        return dropped

    return prune


def _warmup(
    name: str,
    train_state: TrainState,
    branch: Branch[Any],
    compute: Callable[..., Step],
    photographs: _Photographs,
    last: Stage,
    config: Config,
) -> Stage:
    warmup = config.train.warmup
    iterations = warmup.surfel_iterations if branch is train_state.surfels else warmup.gaussian_iterations

    # These functions read the stages' lengths at each call, because a scheduler may change the lengths.
    def window(densify: DensifyConfig) -> tuple[float, float]:
        return densify.start * stage.iterations, densify.stop * stage.iterations

    def progress(_: Trainable[Any], iteration: int) -> float:
        return iteration / max(1, stage.iterations + last.iterations)

    coarse = None if photographs.small is None else Coarse(photographs.small, warmup.coarse)
    cycle = ViewCycle(photographs.trained_on, seeded(config, 3 if branch is train_state.surfels else 4))
    measure = _measure(train_state, branch.name, photographs)
    convergence = make_convergence(warmup, config.train.paper, iterations, measure)
    light = train_state.environment_map if branch is train_state.gaussians else None
    views = photographs.views
    stage = Stage(
        name, [branch], iterations, views, cycle, compute, window, progress, convergence, light, coarse=coarse
    )
    stage.prune = _pruning(branch, views)
    return stage


def _last_stage(train_state: TrainState, views: list[TrainingView], stages: list[Stage], config: Config) -> Stage:
    """Build the stage of the mutual phase; a single branch trains alone for the same number of iterations.

    stages: the run's list of stages, which the caller may fill in later.
    """

    def window(densify: DensifyConfig) -> tuple[float, float]:
        return 1, densify.mutual_stop * stage.iterations

    def progress(part: Trainable[Any], iteration: int) -> float:
        # The warm-up, the first stage that trains a part, may stop early. This stage completes the decay of its rates.
        planned = next(each.iterations for each in stages if part in (*each.branches, each.environment_map))
        share = (part.steps - iteration) / max(1, planned + stage.iterations)
        return share + (1 - share) * iteration / max(1, stage.iterations)

    name = "mutual"
    if train_state.surfels is not None and train_state.gaussians is not None:
        compute = both_teach(train_state.surfels, train_state.gaussians, config.train, train_state.environment_map)
    elif train_state.surfels is not None:
        name, compute = "alone", surfels_alone(train_state.surfels, config.train, warming=False)
    else:
        assert train_state.gaussians is not None
        name, compute = "alone", gaussians_alone(train_state.gaussians, config.train, warming=False)
    cycle = ViewCycle(len(views), seeded(config, 5))
    iterations = mutual_iterations(config)
    stage = Stage(
        name,
        train_state.branches,
        iterations,
        views,
        cycle,
        compute,
        window,
        progress,
        environment_map=train_state.environment_map,
    )
    return stage


def _finish(train_state: TrainState, views: list[TrainingView], config: Config) -> Stage:
    """Build the stage that trains the rendering branch alone, at the final learning rates; it may end at any iteration.

    If a mesh reflects the environment map, the stage begins at the learning rates of the middle of training, times a
    factor (`Plan.set_reflector`).
    """
    cycle = ViewCycle(len(views), seeded(config, 6))
    if train_state.gaussians is None:
        assert train_state.surfels is not None
        compute = surfels_alone(train_state.surfels, config.train, warming=False)
        return Stage(FINISH, [train_state.surfels], 0, views, cycle, compute, lambda _: (1, 0), lambda *_: 1.0)
    light, surface = train_state.environment_map, None
    if light is not None and train_state.surfels is not None:
        surface = ReflectingSurface(light, train_state.surfels)

    def progress(part: Trainable[Any], iteration: int) -> float:
        if light is None or light.model.reflector is None:
            return 1.0
        return min(1.0, 0.5 + 0.5 * iteration / light.settings.iterations)

    compute = gaussians_alone(train_state.gaussians, config.train, warming=False, surface=surface)
    stage = [train_state.gaussians], 0, views, cycle, compute, lambda _: (1, 0), progress
    return Stage(FINISH, *stage, environment_map=light)


def _measure(train_state: TrainState, branch: str, photographs: _Photographs) -> Callable[[], float]:
    """Return a function that measures a branch's PSNR, dB, on the views held out of its warm-up."""
    held_out = photographs.views[photographs.trained_on :]
    return lambda: mean_psnr(train_state.picture(branch), held_out, photographs.behind)


def _validation_views(config: Config, views: int) -> int:
    """Return the number of views that are held out of a whole warm-up, to judge its convergence."""
    held_out = config.train.paper.stop_rule is StopRule.VALIDATION
    return min(config.train.paper.validation_views, views // 2) if held_out else 0


def _spared(config: Config, views: int) -> int:
    """Return the number of views that are held out for model selection."""
    return min(config.train.model_selection.views, views // 4)


def _spread(items: Sequence[T], count: int) -> list[T]:
    """Return `count` evenly spaced items, or all if there are fewer."""
    count = min(count, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]
