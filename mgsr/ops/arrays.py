"""Handing tensors to the kernels."""

from __future__ import annotations

import torch


def plain(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor as a kernel reads it: contiguous and outside the graph (no copy where it already is)."""
    return tensor.detach().contiguous()
