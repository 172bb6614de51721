"""The plan of a run: its stages, built from the settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import torch

from mgsr.config import Branches, Config, DensifyConfig, Growth, Reflection, StopRule, volume_settings
from mgsr.data.backdrop import Backdrop, Color, backdrop
from mgsr.data.scene import Scene
from mgsr.densify.carried import carried, faintest
from mgsr.densify.clearance import Clearance
from mgsr.errors import TrainingError
from mgsr.gaussians.reflector import Reflector
from mgsr.training.branch import Branch
from mgsr.training.convergence import make_convergence
from mgsr.training.evaluate import mean_psnr
from mgsr.training.growth import ErrorGrowth
from mgsr.training.pace import FINISH
from mgsr.training.parts import Parts, StartingPoints, make_parts, seeded
from mgsr.training.stages import Coarse, Stage, Step, Trial, WhatIsMirrored, both_teach, surfels_alone, volumes_alone
from mgsr.training.trained import Trained
from mgsr.training.trial import ReflectionTrial
from mgsr.training.views import CPU, TrainingView, ViewCycle, prepare_views

T = TypeVar("T")


@dataclass(frozen=True)
class Plan:
    """A run before its first iteration.

    parts: what it trains; stages; curve_views: the views that only its curve looks at; backdrop: what lies behind the
    splats.
    """

    parts: Parts
    stages: list[Stage]
    curve_views: list[TrainingView]
    backdrop: Backdrop

    @property
    def trial(self) -> Trial | None:
        """Return the trial of what the 3D branch adds to the transmitted light; None where there is no trial."""
        return next((stage.trial for stage in self.stages if stage.trial is not None), None)

    def mirror_at(self, reflector: Reflector) -> bool:
        """Let a mesh mirror the light from the stage FINISH on, and return whether it does.

        It does where there is such light, and masks tell the object.
        """
        finish, light = self.stages[-1], self.parts.light
        if finish.name != FINISH or light is None or not (light.used and light.settings.iterations):
            return False
        if any(view.mask is None for view in finish.views):
            return False
        light.model.reflector = reflector
        finish.iterations = light.settings.iterations
        return True


@dataclass(frozen=True)
class _Photographs:
    """A stage's views, and reduced copies of them where they are large enough.

    The last `held_back` of both are kept from training. behind: the colour on which renderings of them are judged.
    """

    views: list[TrainingView]
    small: list[TrainingView] | None
    behind: Color
    held_back: int = 0

    @property
    def trained_on(self) -> int:
        return len(self.views) - self.held_back

    def sparing(self, count: int) -> _Photographs:
        """Return the same with `count` views, at even distances, kept from the stage."""
        spared = _spread(range(len(self.views)), count)
        order = [i for i in range(len(self.views)) if i not in spared] + spared
        small = None if self.small is None else [self.small[i] for i in order]
        return _Photographs([self.views[i] for i in order], small, self.behind, count)


def make_plan(
    scene: Scene, start: StartingPoints, config: Config, device: torch.device = CPU, finish: bool = False
) -> Plan:
    """Build the branches on the starting points, all on `device`, and the stages that the settings ask for.

    With `finish`, or where a mesh may mirror the light in the end, there is one more stage, of no iterations yet, in
    which the branch that renders goes on alone.

    Raises TrainingError for too few training views.
    """
    if len(scene.train) < 2:
        raise TrainingError(f"scene {scene.name}: expected at least 2 training views, got {len(scene.train)}")
    behind = backdrop(scene, config.train.background)
    photographs = _photographs(scene, behind.color, config, device)
    reflection, tried = _first_reflection(config, start.shiny, len(scene.train))
    parts = make_parts(scene, start, config, reflection, tried, device)
    volumes, growth = volume_settings(config.train.volumes, scene.masked), None
    if parts.volumes is not None and volumes.densify.by is Growth.ERROR:
        growth = ErrorGrowth(parts.volumes, parts, volumes, behind.color)
    stages: list[Stage] = []
    last = _last_stage(parts, photographs.views, stages, config)
    last.growth = growth
    clearance = None
    if not scene.masked and config.train.clearance:
        cameras = [view.camera for view in scene.train]
        clearance = Clearance.around(cameras, start.positions, config.train.clearance)
    if parts.surfels is not None:
        stages.append(_surfel_warmup(parts, photographs, last, config))
    if parts.volumes is not None:
        stages.append(_volume_warmup(parts, photographs, last, config, tried))
        stages[-1].growth = growth
    stages.append(last)
    for stage in stages:
        stage.clearance = clearance
    if finish or (parts.light is not None and scene.masked and config.train.mirror.iterations):
        stages.append(_finish(parts, photographs.views, config))
    curve_views = prepare_views(_spread(scene.test, config.train.watch.curve_views), scene.masked, device=device)
    return Plan(parts, stages, curve_views, behind)


def mutual_iterations(config: Config) -> int:
    """Return the iterations of the mutual phase, or of a lone branch in its place."""
    return round(config.train.mutual.iterations * config.train.mutual.iterations_factor)


def _first_reflection(config: Config, shiny: bool | None, views: int) -> tuple[Reflection, bool]:
    """Return what the 3D branch adds to the transmitted light at first, and whether a trial decides on more."""
    asked, alone = config.train.volumes.reflection, config.train.branches is Branches.VOLUMES
    if asked is not Reflection.AUTO:
        return asked, False
    if config.train.trial.iterations and _spared(config, views):
        return Reflection.OFF, True
    if shiny is False:
        return Reflection.OFF, False
    return Reflection.OWN if alone else Reflection.SHARED if shiny else Reflection.BOTH, False


def _photographs(scene: Scene, behind: Color, config: Config, device: torch.device) -> _Photographs:
    train, margin = config.train, config.train.crop_margin if _silhouettes_count(config) else None
    views = prepare_views(scene.train, scene.masked, margin, train.surfels.edge_band, device)
    shortest = min(min(view.camera.width, view.camera.height) for view in views)
    if not train.warmup.coarse or shortest < train.warmup.coarse_side:
        return _Photographs(views, None, behind)
    half = None if margin is None else -(-margin // 2)
    band = -(-train.surfels.edge_band // 2)
    return _Photographs(views, prepare_views(scene.train, scene.masked, half, band, device, reduce=2), behind)


def _surfel_warmup(parts: Parts, photographs: _Photographs, last: Stage, config: Config) -> Stage:
    assert parts.surfels is not None
    photographs = photographs.sparing(_held_back(config, len(photographs.views)))
    compute = surfels_alone(parts.surfels, config.train, warming=True)
    return _warmup("warmup_surfels", parts, parts.surfels, compute, photographs, last, config)


def _volume_warmup(parts: Parts, photographs: _Photographs, last: Stage, config: Config, tried: bool) -> Stage:
    assert parts.volumes is not None
    views = len(photographs.views)
    held_back = _held_back(config, views)
    photographs = photographs.sparing(max(held_back, _spared(config, views) if tried else 0))
    mirrored = None
    if parts.light is not None and parts.surfels is not None:
        mirrored = WhatIsMirrored(parts.light, parts.surfels)
    compute = volumes_alone(parts.volumes, config.train, warming=True, mirrored=mirrored)
    stage = _warmup("warmup_volumes", parts, parts.volumes, compute, photographs, last, config)
    if tried:
        measure = _measure(parts, "volumes", photographs)
        seen_after = views - held_back
        stage.trial = ReflectionTrial(config.train, parts.volumes, parts.light, measure, seen_after)
    return stage


def _thinning(branch: Branch[Any], views: list[TrainingView]) -> Callable[[], int]:
    """Return a function that prunes a branch's splats of least contribution, and returns their number.

    Those go that together carry the share of the light that the branch's settings can do without.
    """
    share = branch.densify.drop_carrying

    def thin() -> int:
        if not share or any(view.mask is None for view in views):
            return 0
        kept = (~faintest(carried(branch.model, [view.camera for view in views]), share)).nonzero().squeeze(1)
        dropped = len(branch.model) - len(kept)
        branch.keep(kept)
        return dropped

    return thin


def _warmup(
    name: str,
    parts: Parts,
    branch: Branch[Any],
    compute: Callable[..., Step],
    photographs: _Photographs,
    last: Stage,
    config: Config,
) -> Stage:
    warmup = config.train.warmup
    iterations = warmup.surfel_iterations if branch is parts.surfels else warmup.volume_iterations

    # The stages' lengths are read anew each time, for a pace may change them on the way.
    def window(densify: DensifyConfig) -> tuple[float, float]:
        return densify.start * stage.iterations, densify.stop * stage.iterations

    def progress(_: Trained[Any], iteration: int) -> float:
        return iteration / max(1, stage.iterations + last.iterations)

    coarse = None if photographs.small is None else Coarse(photographs.small, warmup.coarse)
    cycle = ViewCycle(photographs.trained_on, seeded(config, 3 if branch is parts.surfels else 4))
    measure = _measure(parts, branch.name, photographs)
    convergence = make_convergence(warmup, iterations, measure)
    light = parts.light if branch is parts.volumes else None
    views = photographs.views
    stage = Stage(
        name, [branch], iterations, views, cycle, compute, window, progress, convergence, light, coarse=coarse
    )
    stage.thin = _thinning(branch, views)
    return stage


def _last_stage(parts: Parts, views: list[TrainingView], stages: list[Stage], config: Config) -> Stage:
    """Build the stage of the mutual phase; for one branch alone, of as many more iterations of its own.

    stages: those of the run, which may be filled in later.
    """

    def window(densify: DensifyConfig) -> tuple[float, float]:
        return 1, densify.mutual_stop * stage.iterations

    def progress(part: Trained[Any], iteration: int) -> float:
        # A warm-up that stopped early leaves the rest of its fading to this stage. The first that trains a part is it.
        planned = next(each.iterations for each in stages if part in (*each.branches, each.light))
        begun = (part.steps - iteration) / max(1, planned + stage.iterations)
        return begun + (1 - begun) * iteration / max(1, stage.iterations)

    name = "mutual"
    if parts.surfels is not None and parts.volumes is not None:
        compute = both_teach(parts.surfels, parts.volumes, config.train, parts.light)
    elif parts.surfels is not None:
        name, compute = "alone", surfels_alone(parts.surfels, config.train, warming=False)
    else:
        assert parts.volumes is not None
        name, compute = "alone", volumes_alone(parts.volumes, config.train, warming=False)
    cycle = ViewCycle(len(views), seeded(config, 5))
    iterations = mutual_iterations(config)
    stage = Stage(name, parts.branches, iterations, views, cycle, compute, window, progress, light=parts.light)
    return stage


def _finish(parts: Parts, views: list[TrainingView], config: Config) -> Stage:
    """Build the stage in which the branch that renders goes on alone, at the last learning rates; it may end anywhere.

    Once a mesh mirrors the light, the rates begin at those of the middle of training instead.
    """
    cycle = ViewCycle(len(views), seeded(config, 6))
    if parts.volumes is None:
        assert parts.surfels is not None
        compute = surfels_alone(parts.surfels, config.train, warming=False)
        return Stage(FINISH, [parts.surfels], 0, views, cycle, compute, lambda _: (1, 0), lambda *_: 1.0)
    light, mirrored = parts.light, None
    if light is not None and parts.surfels is not None:
        mirrored = WhatIsMirrored(light, parts.surfels)

    def progress(part: Trained[Any], iteration: int) -> float:
        if light is None or light.model.reflector is None:
            return 1.0
        return min(1.0, 0.5 + 0.5 * iteration / light.settings.iterations)

    compute = volumes_alone(parts.volumes, config.train, warming=False, mirrored=mirrored)
    stage = [parts.volumes], 0, views, cycle, compute, lambda _: (1, 0), progress
    return Stage(FINISH, *stage, light=light)


def _measure(parts: Parts, branch: str, photographs: _Photographs) -> Callable[[], float]:
    """Return a function that measures a branch's PSNR, dB, on the views that are kept from its warm-up."""
    held_back = photographs.views[photographs.trained_on :]
    return lambda: mean_psnr(parts.picture(branch), held_back, photographs.behind)


def _silhouettes_count(config: Config) -> bool:
    """Return whether the alpha losses of both branches look after what lies outside the masks' boxes."""
    return config.train.surfels.alpha_weight > 0 and config.train.volumes.alpha_weight > 0


def _held_back(config: Config, views: int) -> int:
    """Return the number of views that are kept from a whole warm-up, to judge its convergence."""
    held_back = config.train.warmup.stop_rule is StopRule.HELD_BACK
    return min(config.train.warmup.held_back_views, views // 2) if held_back else 0


def _spared(config: Config, views: int) -> int:
    """Return the number of views that are kept for a trial."""
    return min(config.train.trial.views, views // 4)


def _spread(items: Sequence[T], count: int) -> list[T]:
    """Return `count` items at even distances, or all if there are fewer."""
    count = min(count, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]
