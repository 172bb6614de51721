"""Builds a run's branches and stages from its settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from mgsr.config import Branches, Config, DensifyConfig, Mirror, StopRule
from mgsr.data.scene import Scene
from mgsr.errors import TrainingError
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.start import start_surfels, start_volumes
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.training.branch import Branch
from mgsr.training.convergence import make_convergence
from mgsr.training.evaluate import Picture, mean_psnr, surfel_picture, volume_picture
from mgsr.training.light import LightInTraining
from mgsr.training.stages import (
    Stage,
    Step,
    SurfelBranch,
    VolumeBranch,
    WhatIsMirrored,
    both_teach,
    surfels_alone,
    volumes_alone,
)
from mgsr.training.trained import Trained
from mgsr.training.views import CPU, TrainingView, ViewCycle, plain_background, prepare_views


class StartingPoints(Protocol):
    """Where splats begin: positions [P,3] in the scene's frame, normals [P,3] or None, colors [P,3]; shiny: whether
    brightness was seen to change from view to view as light does, None if that was not looked at."""

    @property
    def positions(self) -> np.ndarray: ...

    @property
    def normals(self) -> np.ndarray | None: ...

    @property
    def colors(self) -> np.ndarray: ...

    @property
    def shiny(self) -> bool | None: ...


@dataclass(frozen=True)
class Plan:
    """A run before its first iteration: its branches (None where the method has none), the light that the surface
    mirrors (None where it has no use), stages, and the views that only its curve looks at."""

    surfels: SurfelBranch | None
    volumes: VolumeBranch | None
    light: LightInTraining | None
    stages: list[Stage]
    curve_views: list[TrainingView]

    @property
    def branches(self) -> list[Branch]:
        """Those that there are."""
        return [branch for branch in (self.surfels, self.volumes) if branch is not None]

    @property
    def trained(self) -> list[Trained]:
        """The branches, and the light."""
        return [*self.branches, *([] if self.light is None else [self.light])]

    @property
    def models(self) -> tuple[SurfelModel | None, VolumeModel | None, MirroredLight | None]:
        """As they stand: of the 2D branch, the 3D branch and the light."""
        surfels = None if self.surfels is None else self.surfels.model
        volumes = None if self.volumes is None else self.volumes.model
        return surfels, volumes, None if self.light is None else self.light.model

    def picture(self, branch: str) -> Picture:
        """How a branch, surfels or volumes, renders."""
        return _pictures(self.surfels, self.volumes, self.light)[branch]


def make_plan(scene: Scene, start: StartingPoints, config: Config, device: torch.device = CPU) -> Plan:
    """Branches on the starting points, all on `device`, and the stages that the settings ask for.

    Every generator is seeded from config.seed and its own purpose, so that one stage's length does not change
    another's draws.
    """
    if len(scene.train) < 2:
        raise TrainingError(f"scene {scene.name}: expected at least 2 training views, got {len(scene.train)}")
    margin = config.train.crop_margin if _silhouettes_count(config) else None
    views = prepare_views(scene.train, scene.masked, margin, config.train.surfels.edge_band, device)
    surfels, volumes = _make_branches(scene, start, config, device)
    light = _make_light(surfels, volumes, start.shiny, config, device)
    pictures = _pictures(surfels, volumes, light)
    warmup_views, held_back = _hold_back(views, config)
    stages: list[Stage] = []
    if surfels is not None:
        compute = surfels_alone(surfels, config.train, warming=True)
        measured = _Measured(pictures["surfels"], held_back)
        stages.append(_warmup("warmup_surfels", surfels, None, compute, warmup_views, measured, config))
    if volumes is not None:
        mirrored = None if light is None or surfels is None else WhatIsMirrored(light, surfels)
        compute = volumes_alone(volumes, config.train, warming=True, mirrored=mirrored)
        measured = _Measured(pictures["volumes"], held_back)
        stages.append(_warmup("warmup_volumes", volumes, light, compute, warmup_views, measured, config))
    stages.append(_last_stage(surfels, volumes, light, views, config))
    curve_views = prepare_views(_spread(scene.test, config.train.watch.curve_views), scene.masked, device=device)
    return Plan(surfels, volumes, light, stages, curve_views)


def camera_extent(scene: Scene) -> float:
    """3DGS's size of a scene: 1.1 times the largest distance of a training camera from their mean."""
    centers = np.stack([view.camera.center for view in scene.train])
    return 1.1 * max(float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()), 1e-3)


def mutual_iterations(config: Config) -> int:
    """Iterations of the last stage."""
    return round(config.train.mutual.iterations * config.train.mutual.iterations_factor)


def _make_branches(
    scene: Scene, start: StartingPoints, config: Config, device: torch.device
) -> tuple[SurfelBranch | None, VolumeBranch | None]:
    train, extent = config.train, camera_extent(scene)
    points = (start.positions, start.normals, start.colors)
    surfels, volumes = None, None
    if train.branches is not Branches.VOLUMES:
        generator = _generator(config, 1)
        model = start_surfels(*points, train.surfels, generator).to(device)
        surfels = Branch("surfels", model, train.surfels.rates, train.surfels.densify, extent, generator)
    if train.branches is not Branches.SURFELS:
        generator = _generator(config, 2)
        full = start_volumes(*points, train.volumes, generator).to(device)
        volumes = Branch("volumes", full, train.volumes.rates, train.volumes.densify, extent, generator)
    return surfels, volumes


def _make_light(
    surfels: SurfelBranch | None,
    volumes: VolumeBranch | None,
    shiny: bool | None,
    config: Config,
    device: torch.device,
) -> LightInTraining | None:
    settings = config.train.mirror
    wanted = settings.use is Mirror.ON or (settings.use is Mirror.AUTO and shiny is not False)
    if not wanted or surfels is None or volumes is None or not volumes.model.split:
        return None
    return LightInTraining(MirroredLight.uniform(settings.side, settings.start).to(device), settings)


def _pictures(
    surfels: SurfelBranch | None, volumes: VolumeBranch | None, light: LightInTraining | None
) -> dict[str, Picture]:
    pictures = {}
    if surfels is not None:
        pictures["surfels"] = surfel_picture(surfels.model)
    if volumes is not None:
        flat, shared = (None, None) if light is None or surfels is None else (surfels.model, light.model)
        pictures["volumes"] = volume_picture(volumes.model, flat, shared)
    return pictures


@dataclass(frozen=True)
class _Measured:
    """What judges convergence under the rule held_back: a branch's picture of these views."""

    picture: Picture
    views: list[TrainingView]


def _warmup(
    name: str,
    branch: Branch,
    light: LightInTraining | None,
    compute: Callable[..., Step],
    views: list[TrainingView],
    measured: _Measured,
    config: Config,
) -> Stage:
    iterations, after = _planned(branch, config), mutual_iterations(config)

    def window(densify: DensifyConfig) -> tuple[float, float]:
        return densify.start * iterations, densify.stop * iterations

    def progress(_: Trained, iteration: int) -> float:
        return iteration / max(1, iterations + after)

    def measure() -> float:
        return mean_psnr(measured.picture, measured.views, plain_background(config.train.background))

    cycle = ViewCycle(len(views), _generator(config, 3 if branch.name == "surfels" else 4))
    convergence = make_convergence(config.train.warmup, iterations, measure)
    return Stage(name, [branch], iterations, views, cycle, compute, window, progress, convergence, light)


def _last_stage(
    surfels: SurfelBranch | None,
    volumes: VolumeBranch | None,
    light: LightInTraining | None,
    views: list[TrainingView],
    config: Config,
) -> Stage:
    """The mutual phase, or, for one branch alone, as many more iterations of its own."""
    iterations = mutual_iterations(config)

    def window(densify: DensifyConfig) -> tuple[float, float]:
        return 1, densify.mutual_stop * iterations

    def progress(part: Trained, iteration: int) -> float:
        # A warm-up that stopped early leaves the rest of its fading to this stage.
        begun = (part.steps - iteration) / max(1, _planned(part, config) + iterations)
        return begun + (1 - begun) * iteration / max(1, iterations)

    name = "mutual"
    if surfels is not None and volumes is not None:
        compute = both_teach(surfels, volumes, config.train, light)
    elif surfels is not None:
        name, compute = "alone", surfels_alone(surfels, config.train, warming=False)
    else:
        assert volumes is not None
        name, compute = "alone", volumes_alone(volumes, config.train, warming=False)
    branches: list[Branch] = [branch for branch in (surfels, volumes) if branch is not None]
    cycle = ViewCycle(len(views), _generator(config, 5))
    return Stage(name, branches, iterations, views, cycle, compute, window, progress, light=light)


def _planned(part: Trained, config: Config) -> int:
    """Iterations of its warm-up; the light warms up with the 3D branch."""
    warmup = config.train.warmup
    return warmup.surfel_iterations if part.name == "surfels" else warmup.volume_iterations


def _silhouettes_count(config: Config) -> bool:
    """Whether the alpha losses see to what lies outside the masks' boxes."""
    return config.train.surfels.alpha_weight > 0 and config.train.volumes.alpha_weight > 0


def _hold_back(views: list[TrainingView], config: Config) -> tuple[list[TrainingView], list[TrainingView]]:
    """The warm-up's views, and those kept from it to judge its convergence (only under that rule)."""
    if config.train.warmup.stop_rule is not StopRule.HELD_BACK:
        return views, []
    held_back = _spread(views, min(config.train.warmup.held_back_views, len(views) // 2))
    names = {view.name for view in held_back}
    return [view for view in views if view.name not in names], held_back


def _spread(items: list, count: int) -> list:
    """`count` items at even distances, or all if there are fewer."""
    count = min(count, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]


def _generator(config: Config, purpose: int) -> torch.Generator:
    return torch.Generator().manual_seed(config.seed * 1000 + purpose)
