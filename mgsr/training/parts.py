"""What a run trains, made from the starting points: the branches, and the environment maps that the surface mirrors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch

from mgsr.config import Branches, Config, Reflection, volume_settings
from mgsr.data.scene import Scene
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.start import start_surfels, start_volumes
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.training.branch import Branch
from mgsr.training.evaluate import Picture, surfel_picture, volume_picture
from mgsr.training.light import LightInTraining
from mgsr.training.stages import SurfelBranch, VolumeBranch
from mgsr.training.trained import Trained


class StartingPoints(Protocol):
    """The points where splats begin.

    positions [P,3] in the scene's frame, normals [P,3] or None, colors [P,3]; shiny: whether brightness was seen to
    change from view to view as light does, None if that was not looked at.
    """

    @property
    def positions(self) -> np.ndarray: ...

    @property
    def normals(self) -> np.ndarray | None: ...

    @property
    def colors(self) -> np.ndarray: ...

    @property
    def shiny(self) -> bool | None: ...


@dataclass(frozen=True)
class Parts:
    """The branches and the environment maps of a run.

    A branch is None where the method has none; light is None where it can't come to be of use.
    """

    surfels: SurfelBranch | None
    volumes: VolumeBranch | None
    light: LightInTraining | None

    @property
    def branches(self) -> list[Branch[Any]]:
        """Return the branches that there are."""
        return [branch for branch in (self.surfels, self.volumes) if branch is not None]

    @property
    def trained(self) -> list[Trained[Any]]:
        """Return the branches, and the light where there is one."""
        return [*self.branches, *([] if self.light is None else [self.light])]

    @property
    def models(self) -> tuple[SurfelModel | None, VolumeModel | None, MirroredLight | None]:
        """Return the models of the 2D branch, the 3D branch and the light; None for each that is not used."""
        surfels = None if self.surfels is None else self.surfels.model
        volumes = None if self.volumes is None else self.volumes.model
        return surfels, volumes, None if self.light is None or not self.light.used else self.light.model

    def picture(self, branch: str) -> Picture:
        """Return a function that renders a branch, surfels or volumes, as it stands."""
        surfels, volumes, light = self.models
        if branch == "surfels":
            assert surfels is not None
            return surfel_picture(surfels)
        assert volumes is not None
        return volume_picture(volumes, surfels, light)


def make_parts(
    scene: Scene, start: StartingPoints, config: Config, reflection: Reflection, tried: bool, device: torch.device
) -> Parts:
    """Build the branches and the environment maps on the starting points, on `device`.

    reflection: what the 3D branch adds at first; tried: whether a trial may add to it.
    """
    train, extent = config.train, camera_extent(scene)
    points = (start.positions, start.normals, start.colors)
    surfels, volumes, light = None, None, None
    if train.branches is not Branches.VOLUMES:
        generator = seeded(config, 1)
        model = start_surfels(*points, train.surfels, generator).to(device)
        surfels = Branch("surfels", model, train.surfels.rates, train.surfels.densify, extent, generator)
    if train.branches is not Branches.SURFELS:
        generator = seeded(config, 2)
        split = reflection in (Reflection.OWN, Reflection.BOTH)
        full = start_volumes(*points, train.volumes, generator, split).to(device)
        settings = volume_settings(train.volumes, scene.masked)
        volumes = Branch("volumes", full, settings.rates, settings.densify, extent, generator)
    used = reflection in (Reflection.SHARED, Reflection.BOTH)
    if train.branches is Branches.BOTH and (used or tried):
        maps = MirroredLight.uniform(train.mirror.side, train.mirror.start).to(device)
        light = LightInTraining(maps, train.mirror, used)
    return Parts(surfels, volumes, light)


def camera_extent(scene: Scene) -> float:
    """Return 3DGS's size of a scene: 1.1 times the largest distance of a training camera from their mean."""
    centers = np.stack([view.camera.center for view in scene.train])
    return 1.1 * max(float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()), 1e-3)


def seeded(config: Config, purpose: int) -> torch.Generator:
    """Return a generator of its own for each purpose, so that one stage's length does not change another's draws."""
    return torch.Generator().manual_seed(config.seed * 1000 + purpose)
