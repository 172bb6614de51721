"""The trained branches that the steps after training work with."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel


@dataclass(frozen=True)
class Models:
    """The branches in the scene's frame; None for one that the method lacks. At least one is there. light: what the
    surface mirrors, None where that has no use."""

    surfels: SurfelModel | None
    volumes: VolumeModel | None
    light: MirroredLight | None = None

    def to(self, device: torch.device) -> Models:
        """The same on a device."""
        return Models(
            None if self.surfels is None else self.surfels.to(device),
            None if self.volumes is None else self.volumes.to(device),
            None if self.light is None else self.light.to(device),
        )

    @property
    def device(self) -> torch.device:
        """Where they are."""
        model = self.volumes if self.volumes is not None else self.surfels
        assert model is not None
        return model.means.device

    @property
    def counts(self) -> dict[str, int]:
        """Splats by branch."""
        named = {"surfels": self.surfels, "volumes": self.volumes}
        return {name: len(model) for name, model in named.items() if model is not None}
