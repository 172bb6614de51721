"""Edge-aware total variation, pair by pair of slices."""

from __future__ import annotations

import torch


def edge_aware_tv(values: torch.Tensor, guide: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
    values = values.reshape(*guide.shape[:2], -1)
    mask = torch.ones(guide.shape[:2], dtype=values.dtype) if mask is None else mask
    total, count = torch.zeros((), dtype=values.dtype), torch.zeros((), dtype=values.dtype)
    for axis in (0, 1):
        n = guide.shape[axis]
        step = values.narrow(axis, 1, n - 1) - values.narrow(axis, 0, n - 1)
        edge = (guide.narrow(axis, 1, n - 1) - guide.narrow(axis, 0, n - 1)).abs().mean(-1)
        inside = mask.narrow(axis, 1, n - 1) * mask.narrow(axis, 0, n - 1)
        total = total + (step.square().mean(-1) * torch.exp(-edge) * inside).sum()
        count = count + inside.sum()
    return total / count if count > 0 else total
