"""Exposures of photographs, estimated from surface points that several of them show.

The model of an observation is log light = log exposure of the photograph + log radiance of the point. Iteratively
reweighted least squares with Cauchy weights fit both to all observations. Observations of highlights or of hidden
points therefore count little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import PointExposureOptions
from mgsr.data.images import srgb_to_linear
from mgsr.data.robust import robust_deviation
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
    seen = _observations([*train, *test], len(train), positions, normals, options).log_light
    if (np.isfinite(seen[..., 0]).sum(axis=1) < options.min_points).any():
        return None
    exposures: np.ndarray = np.exp(_fitted(seen, len(train), options))
    return exposures


def exposure_gain(
    views: Sequence[View],
    positions: np.ndarray,
    normals: np.ndarray | None,
    options: PointExposureOptions = PointExposureOptions(),
) -> float | None:
    """Return the gain, in dB, by which exposures explain observations to which they were not fitted.

    The exposures of each view are fitted to the points in one half of its image, and tested on those in the other half.
    The result compares the median absolute deviations from the points' radiance without and with these exposures. It is
    about 0, or negative, where all exposures are equal.

    positions [P,3], normals [P,3]: as in `point_exposures`. Returns None if any half shows too few of the points.
    """
    found = _observations(views, len(views), positions, normals, options)
    seen, left = found.log_light, found.left[..., None]
    halves = [np.where(half, seen, np.nan) for half in (left, ~left)]
    if any((np.isfinite(half[..., 0]).sum(axis=1) < options.min_points).any() for half in halves):
        return None
    of_left, of_right = (_fitted(half, len(views), options)[:, None] for half in halves)
    before, after = _deviation(seen), _deviation(seen - np.where(left, of_right, of_left))
    return float(20 * np.log10(max(before, 1e-9) / max(after, 1e-9)))


@dataclass(frozen=True)
class _Observations:
    """The observations of points in views.

    log_light [V,P,3] float32: the log of linear light; NaN where unusable. left [V,P] bool: whether the point is in the
    left half of the points that the view shows.
    """

    log_light: np.ndarray
    left: np.ndarray


def _observations(
    views: Sequence[View],
    train: int,
    positions: np.ndarray,
    normals: np.ndarray | None,
    options: PointExposureOptions,
) -> _Observations:
    """Return the observations of those points that enough of the first `train` views show.

    positions [P,3]: the points. normals [P,3]: unit, or None.
    """
    some = slice(None, None, max(1, -(-len(positions) // options.points)))
    positions, normals = positions[some], None if normals is None else normals[some]
    light = np.full((len(views), len(positions), 3), np.nan, np.float32)
    left = np.zeros(light.shape[:2], bool)
    table = np.log(srgb_to_linear(np.arange(1, 256) / 255))
    side = int(np.sqrt(len(positions)) * options.cells) + 1
    for view, row, half in zip(views, light, left, strict=True):
        index, rows, columns = seen_pixels(view, positions, normals, options.behind, side, options.min_cosine)
        values = view.image[rows, columns]
        good = ((values >= options.dark) & (values < options.clipped)).all(axis=1)
        row[index[good]] = table[values[good].astype(np.intp) - 1]
        if good.any():
            half[index[good]] = columns[good] < np.median(columns[good])
    shared = np.flatnonzero(np.isfinite(light[:train, :, 0]).sum(axis=0) >= options.shared)
    shared = shared[:: max(1, -(-len(views) * len(shared) // options.max_observations))]
    return _Observations(light[:, shared], left[:, shared])


def _deviation(log_light: np.ndarray) -> float:
    """Return the median absolute deviation of log light [V,P,3] from each point's median; NaN entries are left out."""
    flat = log_light.transpose(1, 2, 0).reshape(-1, len(log_light))
    return float(np.nanmedian(np.abs(flat - np.nanmedian(flat, axis=1, keepdims=True))))


def _fitted(log_light: np.ndarray, train: int, options: PointExposureOptions) -> np.ndarray:
    """Fit the log exposures [V,3] to log light [V,P,3]; NaN where a view does not show a point."""
    channels = np.moveaxis(log_light, -1, 0)
    return np.stack([_fit(channel, train, options) for channel in channels], axis=1)


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
        spread = max(robust_deviation(residual[:train][there[:train]]), 1e-4)
        weight = there / (1 + np.square(residual / (options.outlier * spread)))
    return exposure
