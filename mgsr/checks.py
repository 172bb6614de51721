"""Checks of tensor arguments by shape letters: N splats, C cameras, H x W pixels, K coefficients."""

from __future__ import annotations

from functools import cache

import torch

from mgsr.errors import TensorError


def check_tensors(sizes: dict[str, int] | None = None, **specs: tuple[torch.Tensor | None, str]) -> dict[str, int]:
    """Check shapes like ``check_tensors(means=(means, "N 3"), quats=(quats, "N 4"))``; return the letters' sizes.

    A number in a shape must match; a letter takes the size that it meets first and must then agree everywhere. A shape
    that begins with "?" is that of a tensor which may be None. All tensors must be float32 and on one device.

    Raises TensorError that names the argument, what was expected and what came.
    """
    bound = dict(sizes) if sizes else {}
    device: torch.device | None = None
    for name, (tensor, shape) in specs.items():
        if tensor is None and shape[0] == "?":
            continue
        if not isinstance(tensor, torch.Tensor):
            raise TensorError(f"{name}: expected a tensor [{_expected(shape, bound)}], got {type(tensor).__name__}")
        came, (axes, letters, numbers) = tensor.shape, _parts(shape)
        # Written out: an iteration of training checks a hundred tensors.
        matches = len(came) == axes
        for place, letter in letters if matches else ():
            size = came[place]
            matches = matches and bound.setdefault(letter, size) == size
        for place, number in numbers if matches else ():
            matches = matches and came[place] == number
        if not matches:
            raise TensorError(f"{name}: expected [{_expected(shape, bound)}], got {list(came)}")
        if tensor.dtype is not torch.float32:
            raise TensorError(f"{name}: expected float32, got {tensor.dtype}; call .float() first")
        own = tensor.device
        if device is None:
            device = own
        elif own != device:
            raise TensorError(f"{name}: expected device {device} like the arguments before it, got {own}")
    return bound


@cache
def _parts(shape: str) -> tuple[int, tuple[tuple[int, str], ...], tuple[tuple[int, int], ...]]:
    """Return a shape's number of axes, and the places of its letters and of its numbers."""
    parts = list(enumerate(shape.lstrip("?").split()))
    numbers = tuple((place, int(part)) for place, part in parts if part.isdigit())
    return len(parts), tuple((place, part) for place, part in parts if not part.isdigit()), numbers


def _expected(shape: str, bound: dict[str, int]) -> str:
    return ", ".join(f"{part}={bound[part]}" if part in bound else part for part in shape.lstrip("?").split())
