"""Checks whether float32 holds positions precisely enough.

A float32 number has about seven digits. Far from the frame's origin, the offset uses up most of them, and few remain
for the shape.
"""

from __future__ import annotations

import numpy as np

# Largest rounding error of a position, as a share of the scene's size.
_LOSS = 1e-5


def float_is_too_coarse(low: np.ndarray, high: np.ndarray) -> bool:
    """Return whether float32 rounds positions in a box by more than a 100,000th of its size.

    low, high [3]: the least and the largest corner of the box.
    """
    farthest, size = float(np.maximum(np.abs(low), np.abs(high)).max()), float((high - low).max())
    return farthest * float(np.finfo(np.float32).eps) > _LOSS * size


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest corner [3] of the bounding box of points [P,3]; zeros for no points."""
    if len(points) == 0:
        return np.zeros(3), np.zeros(3)
    return points.min(axis=0), points.max(axis=0)


def middle_for_float(points: np.ndarray) -> np.ndarray | None:
    """Return the centre [3] float64 of the points' bounding box, if float32 is too coarse without it as the origin.

    points [P,3]: in any frame. Returns None if float32 holds them well enough as they are.
    """
    low, high = (np.asarray(corner, np.float64) for corner in box(points))
    return (low + high) / 2 if float_is_too_coarse(low, high) else None
