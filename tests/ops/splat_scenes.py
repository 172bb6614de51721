"""Small scenes that the rasterizers' tests share."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from mgsr.data.camera import Camera


def camera(width: int = 40, height: int = 28, off_center: bool = True) -> Camera:
    """Return a camera two units before the origin, turned a little.

    It has non-square pixels and, unless told otherwise, an off-centre principal point.
    """
    cx, cy = (17.3, 15.1) if off_center else (width / 2, height / 2)
    K = np.array([[45.0, 0, cx], [0, 52.0, cy], [0, 0, 1]])
    angle = 0.2
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0.05, -0.03, 2.0]
    return Camera(K, pose, width, height)


def random_splats(count: int, scale_dims: int, seed: int = 0, size: float = 0.12) -> dict[str, Tensor]:
    """Draw float64 splats around the origin; the depths differ enough for float32 and float64 to sort alike."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=g, dtype=torch.float64)

    return {
        "means": uniform(count, 3, low=-0.6, high=0.6),
        "quats": torch.randn(count, 4, generator=g, dtype=torch.float64),
        "scales": size * uniform(count, scale_dims, low=0.2, high=1.0),
        "opacities": uniform(count, low=0.05, high=0.999),
        "colors": uniform(count, 3),
    }


def splat_arguments(tensors: Iterable[Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return means, quats, scales, opacities and colors, as the rasterizers' first arguments."""
    means, quats, scales, opacities, colors = tensors
    return means, quats, scales, opacities, colors
