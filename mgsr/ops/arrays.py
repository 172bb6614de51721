"""Handing tensors to the kernels."""

from __future__ import annotations

import torch

from mgsr.native.cuda.launcher import launcher_for


def plain(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor as a kernel reads it: contiguous and outside the graph (no copy where it already is)."""
    return tensor.detach().contiguous()


def on_card(tensor: torch.Tensor) -> bool:
    """Whether a card's kernels work on the tensor, so that to read it is to wait for them."""
    return launcher_for(tensor) is not None
