"""Builds a run's branches and stages from its settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from mgsr.config import Branches, Config, DensifyConfig, StopRule
from mgsr.data.scene import Scene
from mgsr.errors import TrainingError
from mgsr.gaussians.start import start_surfels, start_volumes
from mgsr.training.branch import Branch
from mgsr.training.convergence import make_convergence
from mgsr.training.evaluate import mean_psnr
from mgsr.training.stages import Stage, Step, SurfelBranch, VolumeBranch, both_teach, surfels_alone, volumes_alone
from mgsr.training.views import CPU, TrainingView, ViewCycle, plain_background, prepare_views


class StartingPoints(Protocol):
    """Where splats begin: positions [P,3] in the scene's frame, normals [P,3] or None, colors [P,3]."""

    @property
    def positions(self) -> np.ndarray: ...

    @property
    def normals(self) -> np.ndarray | None: ...

    @property
    def colors(self) -> np.ndarray: ...


@dataclass(frozen=True)
class Plan:
    """A run before its first iteration: its branches (None where the method has none), stages, and the views that
    only its curve looks at."""

    surfels: SurfelBranch | None
    volumes: VolumeBranch | None
    stages: list[Stage]
    curve_views: list[TrainingView]

    @property
    def branches(self) -> list[Branch]:
        """Those that there are."""
        return [branch for branch in (self.surfels, self.volumes) if branch is not None]


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
    warmup_views, held_back = _hold_back(views, config)
    stages: list[Stage] = []
    if surfels is not None:
        compute = surfels_alone(surfels, config.train, warming=True)
        stages.append(_warmup("warmup_surfels", surfels, compute, warmup_views, held_back, config))
    if volumes is not None:
        compute = volumes_alone(volumes, config.train, warming=True)
        stages.append(_warmup("warmup_volumes", volumes, compute, warmup_views, held_back, config))
    stages.append(_last_stage(surfels, volumes, views, config))
    curve_views = prepare_views(_spread(scene.test, config.train.watch.curve_views), scene.masked, device=device)
    return Plan(surfels, volumes, stages, curve_views)


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


def _warmup(
    name: str,
    branch: Branch,
    compute: Callable[..., Step],
    views: list[TrainingView],
    held_back: list[TrainingView],
    config: Config,
) -> Stage:
    iterations, after = _planned(branch, config), mutual_iterations(config)

    def window(densify: DensifyConfig) -> tuple[float, float]:
        return densify.start * iterations, densify.stop * iterations

    def progress(_: Branch, iteration: int) -> float:
        return iteration / max(1, iterations + after)

    def measure() -> float:
        return mean_psnr(branch.model, held_back, plain_background(config.train.background))

    cycle = ViewCycle(len(views), _generator(config, 3 if branch.name == "surfels" else 4))
    convergence = make_convergence(config.train.warmup, iterations, measure)
    return Stage(name, [branch], iterations, views, cycle, compute, window, progress, convergence)


def _last_stage(
    surfels: SurfelBranch | None, volumes: VolumeBranch | None, views: list[TrainingView], config: Config
) -> Stage:
    """The mutual phase, or, for one branch alone, as many more iterations of its own."""
    iterations = mutual_iterations(config)

    def window(densify: DensifyConfig) -> tuple[float, float]:
        return 1, densify.mutual_stop * iterations

    def progress(branch: Branch, iteration: int) -> float:
        # A warm-up that stopped early leaves the rest of its fading to this stage.
        begun = (branch.steps - iteration) / max(1, _planned(branch, config) + iterations)
        return begun + (1 - begun) * iteration / max(1, iterations)

    name = "mutual"
    if surfels is not None and volumes is not None:
        compute = both_teach(surfels, volumes, config.train)
    elif surfels is not None:
        name, compute = "alone", surfels_alone(surfels, config.train, warming=False)
    else:
        assert volumes is not None
        name, compute = "alone", volumes_alone(volumes, config.train, warming=False)
    branches: list[Branch] = [branch for branch in (surfels, volumes) if branch is not None]
    return Stage(
        name, branches, iterations, views, ViewCycle(len(views), _generator(config, 5)), compute, window, progress
    )


def _planned(branch: Branch, config: Config) -> int:
    warmup = config.train.warmup
    return warmup.surfel_iterations if branch.name == "surfels" else warmup.volume_iterations


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
