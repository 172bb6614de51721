"""Empty space around cameras, which is kept free of splats in scenes without masks.

A splat close to a camera fills much of its photograph alone, and appears as haze in nearby views. The space between a
camera and the first visible surface is empty, so no splat belongs there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from mgsr.config.expert import DensifyOptions
from mgsr.data.camera import Camera


@dataclass(frozen=True)
class Clearance:
    """Balls around cameras in which no splat may lie: centers [V,3] in the scene's frame and radii [V]."""

    centers: Tensor
    radii: Tensor

    @classmethod
    def around(
        cls,
        cameras: Sequence[Camera],
        points: np.ndarray,
        share: float,
        rank: int = DensifyOptions().clearance_rank,
    ) -> Clearance:
        """Return balls around cameras, with a radius of `share` times the distance to the nearest starting points.

        points [P,3] in the scene's frame. The `rank`-th nearest point gives the distance, as nearer ones may be wrong.
        """
        centers = np.array([camera.center for camera in cameras])
        distances = cKDTree(points).query(centers, k=[min(rank, len(points))])[0][:, 0]
        return cls(torch.from_numpy(centers).float(), torch.from_numpy(share * distances).float())

    def outside(self, means: Tensor) -> Tensor:
        """Return ascending indices [M] int64 of the means [N,3] that lie in no ball."""
        inside = torch.zeros(len(means), dtype=torch.bool, device=means.device)
        for center, radius in zip(self.centers.to(means), self.radii.tolist(), strict=True):
            inside |= (means - center).square().sum(dim=1) < radius**2
        return (~inside).nonzero().squeeze(1)
