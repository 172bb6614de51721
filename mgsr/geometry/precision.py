"""Checks whether float32 holds positions precisely enough.

A float32 number has about seven digits. Far from their frame's origin, most of them say where positions lie, and few
are left for the shape that they make.
"""

from __future__ import annotations

import numpy as np

# What float32 may lose of a position, as a share of the scene's size.
_LOSS = 1e-5


def float_is_too_coarse(low: np.ndarray, high: np.ndarray) -> bool:
    """Tell whether float32 loses more than a 100,000th of the size of the box from `low` to `high`, [3] each."""
    farthest, size = float(np.maximum(np.abs(low), np.abs(high)).max()), float((high - low).max())
    return farthest * float(np.finfo(np.float32).eps) > _LOSS * size


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest coordinates, [3] each, of points [P,3]; zeros for no points."""
    if len(points) == 0:
        return np.zeros(3), np.zeros(3)
    return points.min(axis=0), points.max(axis=0)


def middle_for_float(points: np.ndarray) -> np.ndarray | None:
    """Return the middle [3], float64, of the points' bounding box where float32 needs it as the origin, else None.

    points [P,3]. About this middle, float32 holds the points well enough.
    """
    low, high = (np.asarray(corner, np.float64) for corner in box(points))
    return (low + high) / 2 if float_is_too_coarse(low, high) else None
