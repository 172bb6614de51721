"""The CUDA half of the Adam family: every parameter in one launch."""

from __future__ import annotations

import ctypes
from itertools import accumulate

import torch

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, Pointer, pointer

MAX_GROUPS, THREADS, BLOCK_FLOATS = 16, 256, 1024


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

    _fields_ = (("groups", Int), ("ends", Int * MAX_GROUPS), ("group", Group * MAX_GROUPS))


class AdamBatch:
    """As `mgsr.native._adam.AdamBatch`: parameters gathered, then updated in one launch."""

    def __init__(self, launcher: Launcher, beta1: float, beta2: float, epsilon: float) -> None:
        self._launcher = launcher
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
            params = Params(len(groups), (Int * MAX_GROUPS)(*ends), (Group * MAX_GROUPS)(*groups))
            self._launcher.launch("adam", "adam_update", ends[-1], THREADS, params)
        self._groups = []
