"""Checks of tensor arguments by shape letters: N splats, C cameras, H x W pixels, K coefficients."""

from __future__ import annotations

import torch

from mgsr.errors import TensorError


def check_tensors(sizes: dict[str, int] | None = None, **specs: tuple[torch.Tensor, str]) -> dict[str, int]:
    """Check shapes like ``check_tensors(means=(means, "N 3"), quats=(quats, "N 4"))``; return the letters' sizes.

    A number in a shape must match; a letter takes the size that it meets first and must then agree everywhere.
    All tensors must be float32 and on one device.

    Raises TensorError that names the argument, what was expected and what came.
    """
    bound = dict(sizes or {})
    device: torch.device | None = None
    for name, (tensor, shape) in specs.items():
        if not isinstance(tensor, torch.Tensor):
            raise TensorError(f"{name}: expected a tensor [{_expected(shape, bound)}], got {type(tensor).__name__}")
        letters = shape.split()
        matches = tensor.ndim == len(letters) and all(
            size == (int(letter) if letter.isdigit() else bound.setdefault(letter, size))
            for letter, size in zip(letters, tensor.shape, strict=True)
        )
        if not matches:
            raise TensorError(f"{name}: expected [{_expected(shape, bound)}], got {list(tensor.shape)}")
        if tensor.dtype != torch.float32:
            raise TensorError(f"{name}: expected float32, got {tensor.dtype}; call .float() first")
        device = device or tensor.device
        if tensor.device != device:
            raise TensorError(f"{name}: expected device {device} like the arguments before it, got {tensor.device}")
    return bound


def _expected(shape: str, bound: dict[str, int]) -> str:
    return ", ".join(f"{part}={bound[part]}" if part in bound else part for part in shape.split())
