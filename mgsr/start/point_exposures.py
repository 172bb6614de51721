"""Exposures of photographs, told by points of the surface that several of them show.

The logarithm of a point's light in a photograph is the photograph's exposure plus the point's own light. Both are
fitted to all that photographs show of the points, by least squares that are weighted anew at each round (Cauchy's
weights), so that points which shine in some directions, or are hidden in truth, count little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.data.images import srgb_to_linear
from mgsr.data.scene import View
from mgsr.start.view_colors import seen_pixels

POINTS = 16000  # at most: they also hide each other, and fewer leave gaps
BEHIND = 0.05  # units behind others from which a point is hidden
CELLS = 0.5  # of the depth map that tells so along its side, times the root of the number of points
DARK, CLIPPED = 8, 250  # of 255; pixels outside tell nothing
FITTED = 4_000_000  # values that are fitted to at most, so that memory stays small where photographs are many
SHARED, ENOUGH = 3, 50  # photographs that must show a point, and such points that a photograph must show
ROUNDS = 15  # of new weights
PRIOR = 1e-3  # share of what photographs show that says that they have the common exposure
WIDTH = 0.5  # deviations of the residual at which a point counts half


def point_exposures(
    train: Sequence[View], test: Sequence[View], positions: np.ndarray, normals: np.ndarray | None
) -> np.ndarray | None:
    """Estimate the exposures [V,3] of the training views and then the test views, as factors of linear light.

    Those of the training views have a geometric mean of 1. None is returned where the points [P,3] do not tell those of
    some view. normals [P,3]: points turned away are not seen. The training views alone tell the points' own light.
    """
    some = slice(None, None, max(1, -(-len(positions) // POINTS)))
    seen = _log_light([*train, *test], positions[some], None if normals is None else normals[some])
    shared = np.isfinite(seen[: len(train), :, 0]).sum(axis=0) >= SHARED
    seen = seen[:, shared]
    seen = seen[:, :: max(1, -(-seen.shape[0] * seen.shape[1] // FITTED))]
    if (np.isfinite(seen[..., 0]).sum(axis=1) < ENOUGH).any():
        return None
    fitted = [_fit(seen[..., channel], len(train)) for channel in range(3)]
    exposures: np.ndarray = np.exp(np.stack(fitted, axis=1))
    return exposures


def _log_light(views: Sequence[View], positions: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """Return the logarithm of linear light [V,P,3] that views show of points; NaN where they show nothing of use."""
    light = np.full((len(views), len(positions), 3), np.nan, np.float32)
    table = np.log(srgb_to_linear(np.arange(1, 256) / 255))
    side = int(np.sqrt(len(positions)) * CELLS) + 1
    for view, row in zip(views, light, strict=True):
        index, rows, columns = seen_pixels(view, positions, normals, BEHIND, side)
        values = view.image[rows, columns]
        good = ((values >= DARK) & (values < CLIPPED)).all(axis=1)
        row[index[good]] = table[values[good].astype(np.intp) - 1]
    return light


def _fit(seen: np.ndarray, train: int) -> np.ndarray:
    """Fit the log exposures [V] to one channel's log light [V,P]; NaN where a view does not show a point.

    The first `train` views alone tell the points' own light.
    """
    there = np.isfinite(seen)
    seen = np.where(there, seen, 0.0).astype(np.float64)
    weight = there.astype(np.float64)
    exposure = np.zeros(len(seen))
    for _ in range(ROUNDS):
        of_points = weight[:train]
        total = np.maximum(of_points.sum(axis=0), 1e-12)
        # The points' own light is eliminated from the normal equations.
        normal = np.diag(of_points.sum(axis=1)) - (of_points / total) @ of_points.T
        mean = (of_points * seen[:train]).sum(axis=0) / total
        right = (of_points * (seen[:train] - mean)).sum(axis=1)
        exposure[:train] = np.linalg.solve(normal + PRIOR * np.diag(of_points.sum(axis=1)), right)
        exposure[:train] -= exposure[:train].mean()
        own = (of_points * (seen[:train] - exposure[:train, None])).sum(axis=0) / total
        of_tests = weight[train:]
        exposure[train:] = (of_tests * (seen[train:] - own)).sum(axis=1) / np.maximum(of_tests.sum(axis=1), 1e-12)
        residual = seen - own - exposure[:, None]
        spread = max(1.4826 * float(np.median(np.abs(residual[:train][there[:train]]))), 1e-4)
        weight = there / (1 + np.square(residual / (WIDTH * spread)))
    return exposure
