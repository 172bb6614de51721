"""Oracle of the costs of tilted normals, in float64: one point, one tilt and one observation at a time."""

from __future__ import annotations

import numpy as np


def tilt_cost(
    view_directions: np.ndarray,
    brightness: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    table: np.ndarray,
    outlier: float,
) -> float:
    """Return the robust cost of a point's unit normal [3].

    view_directions [K,3], brightness [K], weights [K]: its observations. table [C,C,C]: the light in the directions of
    the cells of the cube [-1,1]^3. outlier: the residual at which an observation's cost is half its limit.
    """
    cells, residuals = len(table), []
    for eye, seen in zip(view_directions, brightness, strict=True):
        mirrored = 2 * (normal @ eye) * normal - eye
        x, y, z = np.minimum(((mirrored + 1) / 2 * cells).astype(int), cells - 1)
        residuals.append(seen - table[x, y, z])
    diffuse = np.average(residuals, weights=weights) if weights.any() else 0.0
    squares = ((np.array(residuals) - diffuse) / outlier) ** 2
    return float((weights * squares / (1 + squares)).sum())
