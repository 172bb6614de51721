"""The normals that a light model asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MIN_OBSERVATIONS = 5  # photographs that see a point, or nothing is said of it


@dataclass(frozen=True)
class TargetNormals:
    """The normals [P,3] that the light asks for, unit, and the confidence in each, confidence [P], from 0 to 1."""

    normals: np.ndarray
    confidence: np.ndarray
