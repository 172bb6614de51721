"""The trained branches that the steps after training work with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import torch

from mgsr.data.scene import Similarity
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.reflector import Reflector
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel

Splats = TypeVar("Splats", SurfelModel, VolumeModel)


@dataclass(frozen=True)
class Models:
    """The trained branches in the scene's frame, of which there is at least one.

    A branch is None where the method lacks it. light: what the surface mirrors, None where that has no use.
    """

    surfels: SurfelModel | None
    volumes: VolumeModel | None
    light: MirroredLight | None = None

    def to(self, device: torch.device) -> Models:
        """Return the same models on a device."""
        return Models(
            None if self.surfels is None else self.surfels.to(device),
            None if self.volumes is None else self.volumes.to(device),
            None if self.light is None else self.light.to(device),
        )

    def to_scene(self, user_from_scene: Similarity) -> Models:
        """Return models of the user's frame in the scene's."""
        light = self.light
        if light is not None and light.reflector is not None:
            mesh = light.reflector.mesh
            light = replace(light, reflector=Reflector(mesh.moved(user_from_scene.to_scene(mesh.vertices))))
        return Models(
            None if self.surfels is None else _to_scene(self.surfels, user_from_scene),
            None if self.volumes is None else _to_scene(self.volumes, user_from_scene),
            light,
        )

    @property
    def device(self) -> torch.device:
        """Return the device of the models."""
        model = self.volumes if self.volumes is not None else self.surfels
        assert model is not None
        return model.means.device

    @property
    def counts(self) -> dict[str, int]:
        """Return the number of splats by branch."""
        named = {"surfels": self.surfels, "volumes": self.volumes}
        return {name: len(model) for name, model in named.items() if model is not None}


def _to_scene(model: Splats, user_from_scene: Similarity) -> Splats:
    """Return a branch of the user's frame in the scene's; axes are the same in both."""
    # As Similarity.to_scene, in float64: far from the origin float32 would lose the shape.
    offset = torch.from_numpy(user_from_scene.offset).to(model.means.device)
    means = ((model.means.double() - offset) / user_from_scene.scale).float()
    return replace(model, means=means, log_scales=model.log_scales - math.log(user_from_scene.scale))
