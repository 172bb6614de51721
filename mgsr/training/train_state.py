"""The state of training: the branches, and the environment maps that the surface reflects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from mgsr.config import Branches, Config, Reflection, starting_settings
from mgsr.data.scene import Scene
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.gaussians.start import start_gaussians, start_surfels
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.start.points import StartingPoints
from mgsr.training.branch import Branch
from mgsr.training.environment_map import EnvironmentMapTrainer
from mgsr.training.evaluate import RenderFunction, gaussian_picture, surfel_picture
from mgsr.training.stages import GaussianBranch, SurfelBranch
from mgsr.training.trainable import Trainable


@dataclass(frozen=True)
class TrainState:
    """The branches and the environment maps of a run.

    A branch is None if the method lacks it. The environment map is None if the run can't use one.
    """

    surfels: SurfelBranch | None
    gaussians: GaussianBranch | None
    environment_map: EnvironmentMapTrainer | None

    @property
    def branches(self) -> list[Branch[Any]]:
        """Return the existing branches."""
        return [branch for branch in (self.surfels, self.gaussians) if branch is not None]

    @property
    def trainables(self) -> list[Trainable[Any]]:
        """Return the branches, and the environment map where there is one."""
        return [*self.branches, *([] if self.environment_map is None else [self.environment_map])]

    @property
    def model(self) -> TrainedModel:
        """Return the current branches and environment map; None for each that is not used."""
        light = self.environment_map
        return TrainedModel(
            None if self.surfels is None else self.surfels.model,
            None if self.gaussians is None else self.gaussians.model,
            None if light is None or not light.used else light.model,
        )

    def picture(self, branch: str) -> RenderFunction:
        """Return a function that renders the current state of a branch, surfels or gaussians."""
        model = self.model
        if branch == "surfels":
            assert model.surfels is not None
            return surfel_picture(model.surfels)
        return gaussian_picture(model)


def make_train_state(
    scene: Scene, start: StartingPoints, config: Config, reflection: Reflection, tried: bool, device: torch.device
) -> TrainState:
    """Build the branches and the environment maps on the starting points, on `device`.

    reflection: the 3D branch's initial reflection model; tried: whether model selection may extend it.
    """
    train, extent = config.train, camera_extent(scene)
    points = (start.positions, start.normals, start.colors)
    detail = config.expert.start.detail(start.surface_pixels)
    flat, full = starting_settings(train, scene.masked, len(start.positions), detail)
    surfels, gaussians, environment_map = None, None, None
    if train.branches is not Branches.GAUSSIANS:
        generator = seeded(config, 1)
        model = start_surfels(*points, flat, generator).to(device)
        surfels = Branch("surfels", model, flat.rates, flat.densify, extent, generator)
    if train.branches is not Branches.SURFELS:
        generator = seeded(config, 2)
        split = reflection in (Reflection.OWN, Reflection.BOTH)
        initial = start_gaussians(*points, full, generator, split).to(device)
        gaussians = Branch("gaussians", initial, full.rates, full.densify, extent, generator)
    used = reflection in (Reflection.SHARED, Reflection.BOTH)
    if train.branches is Branches.BOTH and (used or tried):
        maps = EnvironmentMap.uniform(train.environment_map.side, train.environment_map.start).to(device)
        environment_map = EnvironmentMapTrainer(maps, train.environment_map, used)
    return TrainState(surfels, gaussians, environment_map)


def camera_extent(scene: Scene) -> float:
    """Return the scene's size as 3DGS defines it: 1.1 times the training cameras' largest distance from their mean."""
    centers = np.stack([view.camera.center for view in scene.train])
    return 1.1 * max(float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()), 1e-3)


def seeded(config: Config, purpose: int) -> torch.Generator:
    """Return a separate generator for each purpose, so that one stage's length does not change another's draws."""
    return torch.Generator().manual_seed(config.seed * 1000 + purpose)
