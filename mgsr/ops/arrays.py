"""Handing tensors to the kernels."""

from __future__ import annotations

import torch


def plain(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor as a kernel reads it: contiguous and outside the graph (no copy where it already is)."""
    return tensor.detach().contiguous()


def mean(total: float, weight: float) -> tuple[torch.Tensor, float]:
    """total / weight as a scalar tensor, and 1 / weight; both 0 without weight."""
    scale = 1 / weight if weight else 0.0
    return torch.tensor(total * scale, dtype=torch.float32), scale
