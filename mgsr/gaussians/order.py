"""Morton order: neighbours in space become neighbours in memory."""

from __future__ import annotations

import torch
from torch import Tensor

BITS = 16  # of each axis


def morton_order(means: Tensor) -> Tensor:
    """Return the indices [N] int64 that sort the points means [N,3] along a Morton curve through their bounding box.

    Points that share a cell keep their order; points that are not finite get an arbitrary place. Source: Morton 1966.
    """
    if not len(means):
        return torch.empty(0, dtype=torch.int64, device=means.device)
    low, high = means.amin(dim=0), means.amax(dim=0)
    cells = ((means - low) / (high - low).clamp(min=1e-12) * (2**BITS - 1)).nan_to_num().long().clamp(0, 2**BITS - 1)
    code = _spread_bits(cells[:, 0]) | _spread_bits(cells[:, 1]) << 1 | _spread_bits(cells[:, 2]) << 2
    return torch.sort(code, stable=True).indices


def _spread_bits(x: Tensor) -> Tensor:
    """Insert two zero bits behind each of the lowest 21 bits of x [N] int64."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | x << shift) & mask
    return x
