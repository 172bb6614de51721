"""Environment maps of the light that a shiny surface reflects: parameters that all splats share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from mgsr.gaussians.reflector import Reflector
from mgsr.ops.activations import shares


@dataclass(frozen=True)
class RenderedMap:
    """An environment map as it is rendered, all values 0..1.

    texels [2,S,S,3]: the light from each direction, in the map that is fixed in the scene and in the map that moves
    with the camera.
    bounce [1,3]: the share of the light that a second bounce keeps.
    """

    texels: Tensor
    bounce: Tensor


@dataclass
class EnvironmentMap:
    """Two environment maps of the light from each direction.

    One is fixed in the scene (lamps, windows, the sky); the other moves with the camera (a flash, the photographer).

    logits [2*S*S+1,3] float32: of the light, 0..1 in the images' colours. The scene's map comes first, then the
    camera's, each row by row; the last row is the share of light that a second bounce keeps. Each map is octahedral
    (`octahedral` in `mgsr.renderers.environment_map`). The centre of the scene's map is the scene's z axis; that of the
    camera's map points back to the camera. reflector: the surface that reflects; None where the 2D branch does.
    """

    logits: Tensor
    reflector: Reflector | None = None

    @classmethod
    def uniform(cls, side: int, start: float, reflector: Reflector | None = None) -> EnvironmentMap:
        """Return maps of side x side texels, all of the same light `start`, which must lie inside (0, 1)."""
        return cls(torch.full((2 * side * side + 1, 3), start).logit(), reflector)

    @classmethod
    def of(cls, maps: np.ndarray, bounce: np.ndarray, reflector: Reflector | None = None) -> EnvironmentMap:
        """Return the environment map of `maps` [2,3,S,S] and `bounce` [3], clipped to the inside of (0, 1)."""
        rows = np.concatenate([np.moveaxis(maps, 1, -1).reshape(-1, 3), np.reshape(bounce, (1, 3))])
        return cls(torch.from_numpy(np.clip(rows, 1e-6, 1 - 1e-6).astype(np.float32)).logit(), reflector)

    def __len__(self) -> int:
        return self.logits.shape[0]

    @property
    def side(self) -> int:
        """Return the number of texels along a side of each map."""
        texels: int = round(((len(self) - 1) / 2) ** 0.5)
        return texels

    def rendered(self) -> RenderedMap:
        """Return the maps as shares 0..1, for rendering."""
        texels = shares(self.logits)
        return RenderedMap(texels[:-1].view(2, self.side, self.side, 3), texels[-1:])

    def maps(self) -> Tensor:
        """Return both maps [2,3,S,S]."""
        return self.rendered().texels.permute(0, 3, 1, 2)

    def bounce(self) -> Tensor:
        """Return the share [3] of the light that a second bounce leaves."""
        return self.rendered().bounce[0]

    def parameters(self) -> dict[str, Tensor]:
        """Return the stored tensors by name: logits [2*S*S+1,3]."""
        return {"logits": self.logits}

    def detached(self) -> EnvironmentMap:
        """Return a copy that carries no gradients."""
        return replace(self, logits=self.logits.detach().clone())

    def to(self, device: torch.device) -> EnvironmentMap:
        """Return the same maps on a device (no copy where it already is)."""
        return replace(self, logits=self.logits.to(device))
