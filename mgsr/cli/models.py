"""The trained branches that the steps after training work with."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel


@dataclass(frozen=True)
class Models:
    """The branches in the scene's frame; None for one that the method lacks. At least one is there."""

    surfels: SurfelModel | None
    volumes: VolumeModel | None

    def to(self, device: torch.device) -> Models:
        """The same on a device."""
        surfels = None if self.surfels is None else self.surfels.to(device)
        return Models(surfels, None if self.volumes is None else self.volumes.to(device))

    @property
    def counts(self) -> dict[str, int]:
        """Splats by branch."""
        named = {"surfels": self.surfels, "volumes": self.volumes}
        return {name: len(model) for name, model in named.items() if model is not None}
