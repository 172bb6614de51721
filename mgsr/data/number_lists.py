"""Read lists of numbers, from text or JSON, and the matrices and points that several formats make of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mgsr.data.files import text_number
from mgsr.data.poses import rigid
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError

_GREY = 128.0


def numbers(words: Any, count: int, what: str, source: str) -> np.ndarray:
    """Parse finite numbers [count], float64, from a list of numbers or strings, or from one blank-separated string.

    Raises SceneError, naming `source` and `what`, for anything else.
    """
    values = words.split() if isinstance(words, str) else words
    try:
        found = np.array([_number(value) for value in values], np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.zeros(0)
    if len(found) != count or not np.isfinite(found).all():
        raise SceneError(f"{source}: {what}: expected {_counted(count)}, got {str(words)[:80]!r}; fix the file")
    return found


def matrix(rows: Any, what: str, source: str) -> np.ndarray:
    """Return the matrix [3,3] of three lists of three finite numbers. Raises SceneError with `source` and `what`."""
    if not isinstance(rows, list) or len(rows) != 3:
        raise SceneError(f"{source}: {what}: expected 3 rows of 3 numbers, got {str(rows)[:80]!r}; fix the file")
    return np.stack([numbers(row, 3, what, source) for row in rows])


def _number(value: Any) -> float:
    if isinstance(value, bool):
        raise ValueError("no number")
    return text_number(value.strip()) if isinstance(value, str) else float(value)


def _counted(count: int) -> str:
    return "a number" if count == 1 else f"{count} numbers"


def rotation_of(quaternion: np.ndarray, source: str) -> np.ndarray:
    """Return the rotation [3,3] of a quaternion [4], wxyz, of any length but zero. Raises SceneError with `source`."""
    with np.errstate(over="ignore"):  # what overflows is refused
        norm = float(np.linalg.norm(quaternion))
    if not np.isfinite(norm) or norm < 1e-12:
        raise SceneError(
            f"{source}: the pose has the invalid quaternion {quaternion.tolist()}; fix it or remove the photograph"
        )
    w, x, y, z = quaternion / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_center(rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Return cam_from_world [4,4] of its rotation [3,3] and the camera's center [3] in the world.

    It holds infinite numbers or NaN where the product overflows.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return rigid(rotation, -rotation @ center)


def point_cloud(positions: Any, colors: Any) -> PointCloud | None:
    """Return the points of `positions`, P rows of 3 numbers or texts, with their `colors`, the same from 0 to 255.

    Rows without 3 finite numbers are left out; colours without them become grey. None where no points are left.
    """
    places, shades = _rows(positions), _rows(colors)
    shades[~np.isfinite(shades).all(axis=1)] = _GREY
    finite = np.isfinite(places).all(axis=1)
    if not finite.any():
        return None
    return PointCloud(places[finite], np.clip(shades[finite], 0, 255).astype(np.uint8))


def grey(count: int) -> np.ndarray:
    """Return grey colours [P,3] for points that have none."""
    return np.full((count, 3), _GREY)


def _rows(rows: Any) -> np.ndarray:
    """Return rows of 3 numbers as float64 [P,3], with NaN for rows without them."""
    try:
        table = np.array(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        table = np.zeros(0)
    return table if table.shape == (len(rows), 3) else np.array([_row(row) for row in rows]).reshape(-1, 3)


def _row(row: Any) -> list[float]:
    try:
        values = [_number(value) for value in row]
    except (TypeError, ValueError, OverflowError):
        values = []
    return values if len(values) == 3 else [np.nan] * 3
