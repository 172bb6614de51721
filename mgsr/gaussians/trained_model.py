"""The result of training: both branches and the environment map that they share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import torch

from mgsr.config import Reflection
from mgsr.data.backdrop import WHITE, Color
from mgsr.data.scene import Similarity
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.reflector import Reflector
from mgsr.gaussians.surfels import SurfelModel

Splats = TypeVar("Splats", SurfelModel, GaussianModel)


@dataclass(frozen=True)
class TrainedModel:
    """The trained branches, at least one, and the environment map, all in one frame.

    A branch is None where the method lacks it, and the environment map where it is not used. background: Gaussians of
    what lies around a found object; None where no object was looked for or found. background_color: the colour behind
    these Gaussians, sRGB 0..1.
    """

    surfels: SurfelModel | None
    gaussians: GaussianModel | None
    environment_map: EnvironmentMap | None = None
    background: GaussianModel | None = None
    background_color: Color = WHITE

    def to(self, device: torch.device) -> TrainedModel:
        """Return the same model on a device."""
        return TrainedModel(
            None if self.surfels is None else self.surfels.to(device),
            None if self.gaussians is None else self.gaussians.to(device),
            None if self.environment_map is None else self.environment_map.to(device),
            None if self.background is None else self.background.to(device),
            self.background_color,
        )

    def to_scene(self, user_from_scene: Similarity) -> TrainedModel:
        """Return a model of the user's frame in the scene's."""
        reflected = self.environment_map
        if reflected is not None and reflected.reflector is not None:
            mesh = reflected.reflector.mesh
            reflected = replace(reflected, reflector=Reflector(mesh.moved(user_from_scene.to_scene(mesh.vertices))))
        return TrainedModel(
            None if self.surfels is None else _to_scene(self.surfels, user_from_scene),
            None if self.gaussians is None else _to_scene(self.gaussians, user_from_scene),
            reflected,
            None if self.background is None else _to_scene(self.background, user_from_scene),
            self.background_color,
        )

    def for_gaussians(self) -> TrainedModel:
        """Return the model as the 3D branch needs it: without surfels, unless they reflect the environment map."""
        light = self.environment_map
        return self if light is not None and light.reflector is None else replace(self, surfels=None)

    def detached(self) -> TrainedModel:
        """Return a copy that carries no gradients."""
        return TrainedModel(
            None if self.surfels is None else self.surfels.detached(),
            None if self.gaussians is None else self.gaussians.detached(),
            None if self.environment_map is None else self.environment_map.detached(),
            None if self.background is None else self.background.detached(),
            self.background_color,
        )

    @property
    def reflection(self) -> Reflection | None:
        """Return the 3D branch's reflection model; None without that branch."""
        if self.gaussians is None:
            return None
        if self.gaussians.split:
            return Reflection.OWN if self.environment_map is None else Reflection.BOTH
        return Reflection.OFF if self.environment_map is None else Reflection.SHARED

    @property
    def device(self) -> torch.device:
        """Return the device of the splats."""
        model = self.gaussians if self.gaussians is not None else self.surfels
        assert model is not None
        return model.means.device

    @property
    def counts(self) -> dict[str, int]:
        """Return the number of splats by branch."""
        named = {"surfels": self.surfels, "gaussians": self.gaussians}
        return {name: len(model) for name, model in named.items() if model is not None}


def _to_scene(model: Splats, user_from_scene: Similarity) -> Splats:
    """Return a branch of the user's frame in the scene's; axes are the same in both."""
    # As Similarity.to_scene, in float64: far from the origin float32 would lose the shape.
    offset = torch.from_numpy(user_from_scene.offset).to(model.means.device)
    means = ((model.means.double() - offset) / user_from_scene.scale).float()
    return replace(model, means=means, log_scales=model.log_scales - math.log(user_from_scene.scale))
