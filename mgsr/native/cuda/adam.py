"""The CUDA half of the Adam family: all of an optimiser's parameters in one launch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import torch

from mgsr.native.cuda.launcher import Launcher
from mgsr.native.cuda.params import Float, Int, Long, Pointer, addresses, pointer, pointers
from mgsr.native.structs import AdamParameter

MAX_GROUPS, MAX_JUDGED, THREADS, BLOCK_FLOATS = 16, 32, 256, 1024


class Group(ctypes.Structure):
    """The struct AdamGroup of kernels/adam/group.h."""

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


class AdamParams(ctypes.Structure):
    """The struct AdamParams of kernels/adam/adam.cu."""

    _fields_ = (("groups", Int), ("ends", Int * MAX_GROUPS), *pointers("bad"), ("group", Group * MAX_GROUPS))


class JudgedArray(ctypes.Structure):
    _fields_ = (("end", Int), ("count", Long), *pointers("values"))


class SumOfSquaresParams(ctypes.Structure):
    _fields_ = (("arrays", Int), ("array", JudgedArray * MAX_JUDGED), *pointers("sums"))


class VerdictParams(ctypes.Structure):
    _fields_ = (*pointers("sums"), ("blocks", Int), *pointers("bad"))


def judge(launcher: Launcher, tensors: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return whether the tensors' sum of squares is not finite: [] bool, which the host does not read."""
    assert len(tensors) <= MAX_JUDGED, f"expected at most {MAX_JUDGED} tensors, got {len(tensors)}"
    params, end = SumOfSquaresParams(len(tensors)), 0
    for array, tensor in zip(params.array, tensors, strict=False):
        count = tensor.numel()
        end += -(-count // BLOCK_FLOATS)
        array.end, array.count, array.values = end, count, pointer(tensor)
    sums = tensors[0].new_empty(end, 2, dtype=torch.float64)
    params.sums = pointer(sums)
    launcher.launch("adam", "adam_squares", end, THREADS, params)
    bad = sums.new_empty((), dtype=torch.bool)
    launcher.launch("adam", "adam_verdict", 1, THREADS, VerdictParams(params.sums, end, pointer(bad)))
    return bad


def make_group(parameter: AdamParameter, betas: tuple[float, float], epsilon: float) -> Group:
    """Describe a parameter, which must outlive the group, for the kernel."""
    values, first, second, column_scales = parameter
    group = Group(*values.shape, pointer(values), None, *addresses(first, second, column_scales))
    group.beta1, group.beta2, group.epsilon = *betas, epsilon
    return group


def update(
    launcher: Launcher, groups: Sequence[tuple[Group, torch.Tensor, float, int]], bad: torch.Tensor | None
) -> None:
    """Update parameters in place.

    groups: each with its gradients [rows, columns], its learning rate, and the number of this update, from 1.
    bad [] bool: whether all gradients count as zero.
    """
    for begin in range(0, len(groups), MAX_GROUPS):
        some = groups[begin : begin + MAX_GROUPS]
        params, end = AdamParams(len(some)), 0
        params.bad = pointer(bad)
        for index, (group, gradients, rate, step) in enumerate(some):
            end += -(-gradients.numel() // BLOCK_FLOATS)
            params.ends[index] = end
            group.gradients = pointer(gradients)
            group.rate, group.root_scale = rate / (1 - group.beta1**step), (1 - group.beta2**step) ** -0.5
            params.group[index] = group
        launcher.launch("adam", "adam_update", end, THREADS, params)
