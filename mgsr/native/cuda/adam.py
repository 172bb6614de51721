"""The CUDA half of the Adam family: every parameter in one launch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import accumulate

import torch

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, Pointer, pointer, pointers

MAX_GROUPS, MAX_JUDGED, THREADS, BLOCK_FLOATS = 16, 32, 256, 1024


class Group(ctypes.Structure):
    """AdamGroup of kernels/adam/group.h."""

    _fields_ = (
        ("rows", Long),
        ("columns", Int),
        ("values", Pointer),
        ("gradients", Pointer),
        ("first", Pointer),
        ("second", Pointer),
        ("column_scales", Pointer),
        ("rate", Float),
        ("beta1", Float),
        ("beta2", Float),
        ("epsilon", Float),
        ("root_scale", Float),
    )


class Params(ctypes.Structure):
    """AdamParams of kernels/adam/adam.cu."""

    _fields_ = (("groups", Int), ("ends", Int * MAX_GROUPS), *pointers("bad"), ("group", Group * MAX_GROUPS))


class JudgedArray(ctypes.Structure):
    _fields_ = (("end", Int), ("count", Long), *pointers("values"))


class SquaresParams(ctypes.Structure):
    _fields_ = (("arrays", Int), ("array", JudgedArray * MAX_JUDGED), *pointers("sums"))


class VerdictParams(ctypes.Structure):
    _fields_ = (*pointers("sums"), ("blocks", Int), *pointers("loss", "bad"))


def judge(launcher: Launcher, loss: torch.Tensor, tensors: Sequence[torch.Tensor]) -> torch.Tensor:
    """Whether the loss [] or a number in the tensors is not finite, or has a square that is not: [] bool, not read."""
    assert len(tensors) <= MAX_JUDGED, f"expected at most {MAX_JUDGED} tensors, got {len(tensors)}"
    params = SquaresParams(len(tensors))
    end = 0
    for index, tensor in enumerate(tensors):
        end += -(-tensor.numel() // BLOCK_FLOATS)
        params.array[index] = JudgedArray(end, tensor.numel(), pointer(tensor))
    sums = loss.new_empty(end, 2, dtype=torch.float64)
    params.sums = pointer(sums)
    launcher.launch("adam", "adam_squares", end, THREADS, params)
    bad = loss.new_empty((), dtype=torch.bool)
    verdict = VerdictParams(pointer(sums), end, pointer(loss), pointer(bad))
    launcher.launch("adam", "adam_verdict", 1, THREADS, verdict)
    return bad


class AdamBatch:
    """As `mgsr.native._adam.AdamBatch`: parameters gathered, then updated in one launch."""

    def __init__(
        self, launcher: Launcher, beta1: float, beta2: float, epsilon: float, bad: torch.Tensor | None = None
    ) -> None:
        """bad [] bool: whether all gradients count as zero."""
        self._launcher, self._bad = launcher, bad
        self._betas, self._epsilon = (beta1, beta2), epsilon
        self._groups: list[Group] = []

    def add(
        self,
        values: torch.Tensor,
        gradients: torch.Tensor,
        first: torch.Tensor,
        second: torch.Tensor,
        column_scales: torch.Tensor | None,
        rate: float,
        step: int,
    ) -> None:
        """One parameter [rows, columns]; step: number of this update, counted from 1. Its tensors must stay alive
        until `update` returns."""
        beta1, beta2 = self._betas
        self._groups.append(
            Group(
                *values.shape,
                *(pointer(t) for t in (values, gradients, first, second, column_scales)),
                rate / (1 - beta1**step),
                *(beta1, beta2, self._epsilon),
                (1 - beta2**step) ** -0.5,
            )
        )

    def update(self) -> None:
        """Update all that were added."""
        for begin in range(0, len(self._groups), MAX_GROUPS):
            groups = self._groups[begin : begin + MAX_GROUPS]
            ends = list(accumulate(-(-group.rows * group.columns // BLOCK_FLOATS) for group in groups))
            params = Params(len(groups), (Int * MAX_GROUPS)(*ends), pointer(self._bad), (Group * MAX_GROUPS)(*groups))
            self._launcher.launch("adam", "adam_update", ends[-1], THREADS, params)
        self._groups = []
