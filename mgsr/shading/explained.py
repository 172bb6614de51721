"""What a kind of light says of a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MIN_READINGS = 5  # photographs that see a point, or nothing is said of it


@dataclass(frozen=True)
class Explained:
    """normals [P,3] that the light asks for, unit, and sure [P], 0 where it says nothing to 1 where it is certain."""

    normals: np.ndarray
    sure: np.ndarray
