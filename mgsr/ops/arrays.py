"""Helpers that pass tensors to the kernels."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import torch

from mgsr.errors import TensorError
from mgsr.native.cuda.launcher import launcher_for


def plain(tensor: torch.Tensor) -> torch.Tensor:
    """Return the tensor [...] contiguous and detached, as kernels read it; without a copy if it already is."""
    tensor = tensor.detach() if tensor.requires_grad else tensor
    return tensor if tensor.is_contiguous() else tensor.contiguous()


def on_gpu(tensor: torch.Tensor) -> bool:
    """Return whether the tensor [...] is on a GPU, so that reading its values synchronises."""
    return launcher_for(tensor) is not None


def once_differentiable(backward: Callable[..., Any]) -> Callable[..., Any]:
    """Make a Function's backward raise TensorError if it is itself differentiated.

    Torch's decorator of the same name takes ten times as long per call.
    """

    @wraps(backward)
    def checked(ctx: Any, *gradients: torch.Tensor | None) -> Any:
        """Call backward. Raises TensorError if gradients of gradients are requested."""
        if torch.is_grad_enabled():
            raise TensorError("create_graph: expected False, got True; MGSR's operations have no second derivatives")
        return backward(ctx, *gradients)

    return checked
