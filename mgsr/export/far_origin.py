"""Positions far from their frame's origin.

A float32 number has about seven digits. In map (UTM) and geocentric frames, most of these digits locate the scene, and
few are left for its shape. Files with float32 positions therefore use an origin near the scene and name it: the frame's
positions are those in the file plus that origin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mgsr.data.scene import Similarity
from mgsr.errors import SceneError
from mgsr.geometry.precision import float_is_too_coarse

# Decimal digits that float64 preserves: the text and the number convert to each other exactly.
_DIGITS = 15


def no_origin() -> np.ndarray:
    """Return the origin [3] of files with positions in the frame itself."""
    return np.zeros(3)


def origin_near(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return an origin [3] for positions in the box from `low` [3] to `high` [3].

    It is zeros where float32 holds the positions well enough. Otherwise it is a short number within half the box's size
    of its middle, rounded to a power of ten.
    """
    size = float((high - low).max())
    # A single position has no shape to lose.
    if not (0 < size < math.inf and float_is_too_coarse(low, high)):
        return no_origin()
    decimals = -math.floor(math.log10(size))
    return _short([round(float(value), decimals) for value in (low + high) / 2])


def origin_of_frame(user_from_scene: Similarity, unit: float = 1.0) -> np.ndarray:
    """Return the origin [3] of the files of a scene, in the user's lengths times `unit`.

    The scene's object lies in its frame's unit ball. Zeros where float32 holds the user's positions well enough.
    """
    middle, radius = user_from_scene.offset * unit, user_from_scene.scale * unit
    return origin_near(middle - radius, middle + radius)


def about_origin(user_from_scene: Similarity, unit: float, origin: np.ndarray) -> Similarity:
    """Return the transform from the scene's frame to positions about `origin` [3].

    Positions are in the user's lengths times `unit`.
    """
    return Similarity(user_from_scene.scale * unit, user_from_scene.offset * unit - origin)


def scaled_origin(origin: np.ndarray, scale: float) -> np.ndarray:
    """Return an origin [3] times `scale`, as numbers that survive being written as text."""
    return _short(origin * scale)


def origin_text(origin: np.ndarray) -> str:
    """Return an origin [3] as the text in which files name it, such as "431000 5411000 200"."""
    return " ".join(f"{value:.{_DIGITS}g}" for value in origin)


def read_origin_text(words: Sequence[str], source: str) -> np.ndarray:
    """Return the origin [3] that a file's words name.

    Raises SceneError, naming the source, for anything but three finite numbers.
    """
    try:
        origin = np.array([float(word) for word in words])
    except ValueError:
        origin = np.zeros(0)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise SceneError(
            f"{source}: expected an origin of three finite numbers, got {' '.join(words)[:80]!r}; write the file again"
        )
    return origin


def origin_notes(user_from_scene: Similarity, unit: float = 1.0) -> list[str]:
    """Return a line for the user on the origin of a scene's files (see `origin_of_frame`), or nothing."""
    origin = origin_of_frame(user_from_scene, unit)
    if not origin.any():
        return []
    away = float(f"{np.linalg.norm(user_from_scene.offset * unit):.2g}")
    return [
        f"the frame's origin lies {away:,.{_DIGITS}g} units away, so splat files have positions relative to "
        f"{origin_text(origin)}, which they record; add it to the positions"
    ]


def _short(values: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the values rounded to their texts of 15 digits, without a negative zero."""
    return np.array([float(f"{value:.{_DIGITS}g}") + 0.0 for value in values])
