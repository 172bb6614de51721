"""The trained branches that the steps after training work with."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel


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
