"""Activations of stored parameters on a card, of several tensors in one launch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from enum import IntEnum

from torch import Tensor

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, pointer, pointers

MOST_ARRAYS, THREADS, BLOCK_FLOATS = 8, 256, 1024


class Activation(IntEnum):
    """The activations of kernels/activations/activations.cu."""

    EXP = 0
    SIGMOID = 1


class ActivatedArray(ctypes.Structure):
    _fields_ = (("kind", Int), ("end", Int), ("count", Long), *pointers("in", "v_out", "out"))


class Params(ctypes.Structure):
    _fields_ = (("arrays", Int), ("largest", Float), ("array", ActivatedArray * MOST_ARRAYS))


def activate(
    launcher: Launcher, kinds: Sequence[Activation], largest: float, stored: Sequence[Tensor], used: Sequence[Tensor]
) -> None:
    """Write the activated values of stored tensors [...]; an exponent above `largest` counts as `largest`."""
    _launch(launcher, "forward", kinds, largest, stored, [None] * len(used), used)


def activate_vjp(
    launcher: Launcher,
    kinds: Sequence[Activation],
    largest: float,
    used: Sequence[Tensor],
    v_used: Sequence[Tensor | None],
    v_stored: Sequence[Tensor],
) -> None:
    """Write the gradients [...] of the stored parameters from those of the activated values, all of equal shapes."""
    _launch(launcher, "backward", kinds, largest, used, v_used, v_stored)


def _launch(
    launcher: Launcher,
    direction: str,
    kinds: Sequence[Activation],
    largest: float,
    first: Sequence[Tensor],
    gradients: Sequence[Tensor | None],
    out: Sequence[Tensor],
) -> None:
    assert len(out) <= MOST_ARRAYS, f"expected at most {MOST_ARRAYS} tensors, got {len(out)}"
    params, end = Params(len(out), largest), 0
    for index, (kind, tensor, gradient, written) in enumerate(zip(kinds, first, gradients, out, strict=True)):
        end += -(-tensor.numel() // BLOCK_FLOATS)
        arrays = (pointer(tensor), pointer(gradient), pointer(written))
        params.array[index] = ActivatedArray(kind, end, tensor.numel(), *arrays)
    launcher.launch("activations", f"activations_{direction}", end, THREADS, params)
