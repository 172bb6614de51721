"""Activations of stored parameters: scales from their logarithms, shares from their logits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mgsr.native.cuda.activations import Activation, activate_vjp
from mgsr.native.cuda.activations import activate as activate_on_gpu
from mgsr.native.cuda.launcher import Launcher, launcher_for
from mgsr.ops.arrays import once_differentiable, plain

# exp of a larger number nears float32's maximum. An infinite scale would turn its zero gradient into NaN.
LARGEST_LOG_SCALE = 80.0
LARGEST_SCALE = (1 - 1e-6) * math.exp(LARGEST_LOG_SCALE)  # less than any rounded value of that exponential


def activate(log_scales: Tensor, *logits: Tensor) -> tuple[Tensor, ...]:
    """Return the exponential of the log-scales [...] and the sigmoid of each of the logits [...]; gradients flow.

    Above 80, the exponential is constant and passes no gradient.
    """
    kinds = (Activation.EXP, *(Activation.SIGMOID for _ in logits))
    used: tuple[Tensor, ...] = _Activate.apply(kinds, log_scales, *logits)
    return used


def shares(logits: Tensor) -> Tensor:
    """Return the sigmoid of logits [...]; gradients flow."""
    used: Tensor = _Activate.apply((Activation.SIGMOID,), logits)[0]
    return used


class _Activate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, kinds: Sequence[Activation], *stored: Tensor) -> tuple[Tensor, ...]:
        """Return the activated values of the stored tensors [N,...], in the same shapes."""
        ctx.kinds, ctx.launcher = kinds, launcher_for(stored[0])
        used = activated(ctx.launcher, kinds, [plain(tensor) for tensor in stored])
        ctx.save_for_backward(*used)
        ctx.set_materialize_grads(False)
        return tuple(used)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *v_used: Tensor | None) -> tuple[Any, ...]:
        gradients = [None if v is None else plain(v) for v in v_used]
        return None, *activated_vjp(ctx.launcher, ctx.kinds, ctx.saved_tensors, gradients)


def activated(launcher: Launcher | None, kinds: Sequence[Activation], stored: Sequence[Tensor]) -> list[Tensor]:
    """Return the activated values of contiguous tensors [...], outside the graph.

    launcher: of the GPU's kernels; None on the CPU.
    """
    if launcher is None:
        return [
            each.clamp(max=LARGEST_LOG_SCALE).exp_() if kind is Activation.EXP else each.sigmoid()
            for kind, each in zip(kinds, stored, strict=True)
        ]
    used = [torch.empty_like(each) for each in stored]
    activate_on_gpu(launcher, kinds, LARGEST_LOG_SCALE, stored, used)
    return used


def activated_vjp(
    launcher: Launcher | None, kinds: Sequence[Activation], used: Sequence[Tensor], v_used: Sequence[Tensor | None]
) -> list[Tensor | None]:
    """Return the stored parameters' gradients [...], given those of the activated values; None if there is none."""
    if launcher is None:
        return [_vjp(*each) for each in zip(kinds, used, v_used, strict=True)]
    v_stored = [torch.empty_like(each) for each in used]
    activate_vjp(launcher, kinds, LARGEST_LOG_SCALE, used, v_used, v_stored)
    return list(v_stored)


def _vjp(kind: Activation, used: Tensor, v_used: Tensor | None) -> Tensor | None:
    """Return the gradient [...] of a stored parameter, from the activated values and their gradient [...]."""
    if v_used is None:
        return None
    if kind is Activation.SIGMOID:
        v_logits: Tensor = torch.ops.aten.sigmoid_backward(v_used, used)
        return v_logits
    return (v_used * used).masked_fill_(used >= LARGEST_SCALE, 0.0)
