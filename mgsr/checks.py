"""Checks of tensor arguments by shape letters: N splats, C cameras, H x W pixels, K coefficients."""

from __future__ import annotations

from functools import cache

import torch

from mgsr.errors import TensorError


def check_tensors(sizes: dict[str, int] | None = None, **specs: tuple[torch.Tensor, str]) -> dict[str, int]:
    """Check shapes like ``check_tensors(means=(means, "N 3"), quats=(quats, "N 4"))``; return the letters' sizes.

    A number in a shape must match; a letter takes the size that it meets first and must then agree everywhere.
    All tensors must be float32 and on one device.

    Raises TensorError that names the argument, what was expected and what came.
    """
    bound = dict(sizes) if sizes else {}
    device: torch.device | None = None
    for name, (tensor, shape) in specs.items():
        if not isinstance(tensor, torch.Tensor):
            raise TensorError(f"{name}: expected a tensor [{_expected(shape, bound)}], got {type(tensor).__name__}")
        if not _matches(tensor.shape, _parts(shape), bound):
            raise TensorError(f"{name}: expected [{_expected(shape, bound)}], got {list(tensor.shape)}")
        if tensor.dtype is not torch.float32:
            raise TensorError(f"{name}: expected float32, got {tensor.dtype}; call .float() first")
        own = tensor.device
        if device is None:
            device = own
        elif own != device:
            raise TensorError(f"{name}: expected device {device} like the arguments before it, got {own}")
    return bound


@cache
def _parts(shape: str) -> tuple[int | str, ...]:
    return tuple(int(part) if part.isdigit() else part for part in shape.split())


def _matches(sizes: torch.Size, parts: tuple[int | str, ...], bound: dict[str, int]) -> bool:
    """Whether sizes are those of a shape; letters that are met first are bound."""
    if len(sizes) != len(parts):
        return False
    for size, part in zip(sizes, parts, strict=True):
        if size != (bound.setdefault(part, size) if isinstance(part, str) else part):
            return False
    return True


def _expected(shape: str, bound: dict[str, int]) -> str:
    return ", ".join(f"{part}={bound[part]}" if part in bound else part for part in shape.split())
