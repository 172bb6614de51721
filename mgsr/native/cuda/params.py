"""Kernel parameters: C structs as ctypes, and tensors as their pointers."""

from __future__ import annotations

import ctypes
from typing import Any

import torch

Pointer = ctypes.c_void_p
Int = ctypes.c_int32
Long = ctypes.c_int64
Float = ctypes.c_float
Double = ctypes.c_double


def pointers(*names: str) -> tuple[tuple[str, Any], ...]:
    """Return the fields of a struct that are pointers, by these names."""
    return tuple((name, Pointer) for name in names)


def pointer(tensor: torch.Tensor | None) -> int | None:
    """Return where the data of a tensor [...] begins; for None, the null pointer None.

    The tensor must be contiguous and outlive the launch (on a card: stay in use on the stream of the launch, as torch's
    memory does).
    """
    return None if tensor is None else tensor.data_ptr() if tensor.is_contiguous() else _refuse(tensor)


def addresses(*tensors: torch.Tensor | None) -> list[int | None]:
    """Return the `pointer` of each tensor.

    An iteration of training asks for four hundred: at once, they cost half.
    """
    return [None if t is None else t.data_ptr() if t.is_contiguous() else _refuse(t) for t in tensors]


def _refuse(tensor: torch.Tensor) -> int:
    raise AssertionError(f"expected a contiguous tensor, got strides {tensor.stride()} of shape {[*tensor.shape]}")
