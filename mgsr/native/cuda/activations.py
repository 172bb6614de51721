"""The activations of stored parameters on a GPU, for several tensors in one launch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from enum import IntEnum

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, addresses, pointers

MOST_ARRAYS, THREADS, BLOCK_FLOATS = 8, 256, 1024


class Activation(IntEnum):
    """The activations of kernels/activations/activations.cu."""

    EXP = 0
    SIGMOID = 1


class ActivatedArray(ctypes.Structure):
    _fields_ = (("kind", Int), ("end", Int), ("count", Long), *pointers("in", "v_out", "out"))


class ActivationParams(ctypes.Structure):
    _fields_ = (("arrays", Int), ("largest", Float), ("array", ActivatedArray * MOST_ARRAYS))


def activate(
    launcher: Launcher, kinds: Sequence[Activation], largest: float, stored: Sequence[Tensor], used: Sequence[Tensor]
) -> None:
    """Write the activated values of stored tensors [...]; an exponent above `largest` counts as `largest`."""
    arrays = [(tensor, None, out) for tensor, out in zip(stored, used, strict=True)]
    _launch(launcher, "forward", kinds, largest, arrays)


def activate_vjp(
    launcher: Launcher,
    kinds: Sequence[Activation],
    largest: float,
    used: Sequence[Tensor],
    v_used: Sequence[Tensor | None],
    v_stored: Sequence[Tensor],
) -> None:
    """Write the gradients [...] of the stored parameters, given those of the activated values, in the same shapes."""
    _launch(launcher, "backward", kinds, largest, list(zip(used, v_used, v_stored, strict=True)))


def _launch(
    launcher: Launcher,
    direction: str,
    kinds: Sequence[Activation],
    largest: float,
    arrays: Sequence[tuple[Tensor, Tensor | None, Tensor]],
) -> None:
    """Run a kernel on arrays. Each comes with its gradient, if any, and with the tensor to write."""
    assert len(arrays) <= MOST_ARRAYS, f"expected at most {MOST_ARRAYS} tensors, got {len(arrays)}"
    params, end = ActivationParams(len(arrays), largest), 0
    for index, (kind, (tensor, gradient, written)) in enumerate(zip(kinds, arrays, strict=True)):
        end += -(-tensor.numel() // BLOCK_FLOATS)
        params.array[index] = ActivatedArray(kind, end, tensor.numel(), *addresses(tensor, gradient, written))
    launcher.launch("activations", f"activations_{direction}", end, THREADS, params)
