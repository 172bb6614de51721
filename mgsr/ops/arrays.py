"""The handing over of tensors to the kernels."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import torch

from mgsr.errors import TensorError
from mgsr.native.cuda.launcher import launcher_for


def plain(tensor: torch.Tensor) -> torch.Tensor:
    """Return the tensor as a kernel reads it: contiguous and outside the graph (no copy where it already is)."""
    tensor = tensor.detach() if tensor.requires_grad else tensor
    return tensor if tensor.is_contiguous() else tensor.contiguous()


def on_card(tensor: torch.Tensor) -> bool:
    """Return whether a card's kernels work on the tensor, so that to read it is to wait for them."""
    return launcher_for(tensor) is not None


def once_differentiable(backward: Callable[..., Any]) -> Callable[..., Any]:
    """Let a Function's backward refuse to be differentiated itself, with a TensorError.

    Torch's decorator of the name costs ten times as much in each call.
    """

    @wraps(backward)
    def checked(ctx: Any, *gradients: torch.Tensor | None) -> Any:
        if torch.is_grad_enabled():
            raise TensorError("create_graph: expected False, got True; gradients of MGSR's operations have none")
        return backward(ctx, *gradients)

    return checked
