"""The target normals of a light model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TargetNormals:
    """The normals that explain the photographs under a light.

    normals [P,3]: unit, in the scene's frame. confidence [P]: in each normal, 0..1.
    """

    normals: np.ndarray
    confidence: np.ndarray
