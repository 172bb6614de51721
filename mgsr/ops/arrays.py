"""Handing tensors to the CPU kernels."""

from __future__ import annotations

import torch

from mgsr.errors import TensorError


def host(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor as a kernel reads it: contiguous, on the CPU, outside the graph (no copy where it already is)."""
    if tensor.device.type != "cpu":
        raise TensorError(f"expected a tensor on the CPU, got {tensor.device}; this operation has a CPU kernel only")
    return tensor.detach().contiguous()
