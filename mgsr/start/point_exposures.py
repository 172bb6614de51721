"""Exposures of photographs, estimated from surface points that several of them show.

The model of an observation is log light = log exposure of the photograph + log radiance of the point. Both are fitted
to all observations by iteratively reweighted least squares with Cauchy weights. So observations of highlights or of
hidden points count little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import PointExposureOptions
from mgsr.data.images import srgb_to_linear
from mgsr.data.scene import View
from mgsr.start.view_colors import seen_pixels


def point_exposures(
    train: Sequence[View],
    test: Sequence[View],
    positions: np.ndarray,
    normals: np.ndarray | None,
    options: PointExposureOptions = PointExposureOptions(),
) -> np.ndarray | None:
    """Estimate the exposures [V,3] of the training views and then the test views, as factors of linear light.

    positions [P,3]: surface points in the scene's frame. normals [P,3]: their unit normals, which exclude points that
    face away from a view; None: unknown. The training views alone determine the points' radiance, and the geometric
    mean of their exposures is 1. Returns None if any view shows too few of the points.
    """
    some = slice(None, None, max(1, -(-len(positions) // options.points)))
    seen = _log_light([*train, *test], positions[some], None if normals is None else normals[some], options)
    shared = np.isfinite(seen[: len(train), :, 0]).sum(axis=0) >= options.shared
    seen = seen[:, shared]
    seen = seen[:, :: max(1, -(-seen.shape[0] * seen.shape[1] // options.max_observations))]
    if (np.isfinite(seen[..., 0]).sum(axis=1) < options.min_points).any():
        return None
    fitted = [_fit(seen[..., channel], len(train), options) for channel in range(3)]
    exposures: np.ndarray = np.exp(np.stack(fitted, axis=1))
    return exposures


def _log_light(
    views: Sequence[View], positions: np.ndarray, normals: np.ndarray | None, options: PointExposureOptions
) -> np.ndarray:
    """Return the log of the linear light [V,P,3] that the views show of points [P,3]; NaN where unusable.

    normals [P,3]: unit, or None.
    """
    light = np.full((len(views), len(positions), 3), np.nan, np.float32)
    table = np.log(srgb_to_linear(np.arange(1, 256) / 255))
    side = int(np.sqrt(len(positions)) * options.cells) + 1
    for view, row in zip(views, light, strict=True):
        index, rows, columns = seen_pixels(view, positions, normals, options.behind, side, options.min_cosine)
        values = view.image[rows, columns]
        good = ((values >= options.dark) & (values < options.clipped)).all(axis=1)
        row[index[good]] = table[values[good].astype(np.intp) - 1]
    return light


def _fit(seen: np.ndarray, train: int, options: PointExposureOptions) -> np.ndarray:
    """Fit the log exposures [V] to one channel's log light [V,P]; NaN where a view does not show a point.

    The first `train` views alone determine the points' radiance.
    """
    there = np.isfinite(seen)
    seen = np.where(there, seen, 0.0).astype(np.float64)
    weight = there.astype(np.float64)
    exposure = np.zeros(len(seen))
    for _ in range(options.rounds):
        of_points = weight[:train]
        total = np.maximum(of_points.sum(axis=0), 1e-12)
        # The points' radiance is eliminated from the normal equations.
        normal = np.diag(of_points.sum(axis=1)) - (of_points / total) @ of_points.T
        mean = (of_points * seen[:train]).sum(axis=0) / total
        right = (of_points * (seen[:train] - mean)).sum(axis=1)
        exposure[:train] = np.linalg.solve(normal + options.prior_weight * np.diag(of_points.sum(axis=1)), right)
        exposure[:train] -= exposure[:train].mean()
        own = (of_points * (seen[:train] - exposure[:train, None])).sum(axis=0) / total
        of_tests = weight[train:]
        exposure[train:] = (of_tests * (seen[train:] - own)).sum(axis=1) / np.maximum(of_tests.sum(axis=1), 1e-12)
        residual = seen - own - exposure[:, None]
        spread = max(1.4826 * float(np.median(np.abs(residual[:train][there[:train]]))), 1e-4)
        weight = there / (1 + np.square(residual / (options.outlier * spread)))
    return exposure
