"""Light that a shiny surface mirrors: parameters that all splats share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mgsr.ops.activations import shares


@dataclass
class MirroredLight:
    """Two maps of the light that comes from each direction: one stands still in the scene (lamps, windows, the sky),
    one moves with the camera (a flash, the photographer).

    logits [2*S*S,3] float32: of the light, 0..1 in the images' colours; the scene's map, then the camera's, row by row.
    Each map unfolds the directions' octahedron into a square (`octahedral` in `mgsr.render.mirrored`): in the scene's
    axes, z in the middle; in the camera's, its middle the way back to the camera.
    """

    logits: Tensor

    @classmethod
    def uniform(cls, side: int, start: float) -> MirroredLight:
        """Return maps of side x side texels, all of the light `start`, inside (0, 1)."""
        return cls(torch.full((2 * side * side, 3), start).logit())

    @classmethod
    def of(cls, maps: np.ndarray) -> MirroredLight:
        """From what `maps` gave, [2,3,S,S]."""
        light = torch.from_numpy(np.clip(maps, 1e-6, 1 - 1e-6).astype(np.float32))
        return cls(light.permute(0, 2, 3, 1).reshape(-1, 3).logit())

    def __len__(self) -> int:
        return self.logits.shape[0]

    @property
    def side(self) -> int:
        """Texels along a side of each map."""
        return round((len(self) / 2) ** 0.5)

    def texels(self) -> Tensor:
        """Return the light [2,S,S,3]."""
        return shares(self.logits).view(2, self.side, self.side, 3)

    def maps(self) -> Tensor:
        """Return the light [2,3,S,S]."""
        return self.texels().permute(0, 3, 1, 2)

    def parameters(self) -> dict[str, Tensor]:
        """Every stored tensor by name."""
        return {"logits": self.logits}

    def detached(self) -> MirroredLight:
        """Return a copy that carries no gradients."""
        return MirroredLight(self.logits.detach().clone())

    def to(self, device: torch.device) -> MirroredLight:
        """Return the same light on a device (no copy where it already is)."""
        return MirroredLight(self.logits.to(device))
