"""Oracles of vote fusion, in float64.

Depth maps vote on points one by one, and votes are fused under total variation as convex programs for a general solver.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog, minimize

from mgsr.data.camera import Camera


def misfit(field: np.ndarray, votes: np.ndarray) -> np.ndarray:
    """Return each value's misfit [P]: the votes' weights times the mean distance to their bin's values."""
    edges = np.linspace(-1, 1, votes.shape[1] + 1)
    low, high, value = edges[:-1], edges[1:], field[:, None]
    below, above = np.clip(value - low, 0, high - low), np.clip(high - value, 0, high - low)
    inside = (below**2 + above**2) / 2
    beyond = np.maximum(value - high, 0) + np.maximum(low - value, 0)
    return np.asarray((votes * (inside / (high - low) + beyond)).sum(axis=1))


def total_variation(field: np.ndarray) -> float:
    """Return the sum of the lengths of the forward differences of a field [X,Y,Z]."""
    steps = [np.diff(field, axis=axis, append=field.take([-1], axis)) for axis in range(3)]
    return float(np.sqrt(sum(step**2 for step in steps)).sum())


def energy(field: np.ndarray, votes: np.ndarray, strength: float) -> float:
    """Return the energy of a field [X,Y,Z], of which the fused field has the least; votes [X*Y*Z,B]."""
    return float(misfit(field.ravel(), votes).sum()) + strength * total_variation(field)


def best_row(votes: np.ndarray, strength: float, pieces: int = 24) -> np.ndarray:
    """Return the best field [P] of one row of voxels: a linear program, each bin's votes at `pieces` points."""
    count, bins = votes.shape
    places = (np.arange(bins * pieces) + 0.5) / (bins * pieces) * 2 - 1
    weights = np.repeat(votes / pieces, pieces, axis=1)
    # The variables: the field, the distances to the places, and the steps' sizes.
    cost = np.concatenate([np.zeros(count), weights.ravel(), np.full(count - 1, strength)])
    rows, limits = [], []
    for i in range(count):
        for j, place in enumerate(places):
            for sign in (1, -1):
                row = np.zeros(len(cost))
                row[i], row[count + i * len(places) + j] = sign, -1
                rows.append(row)
                limits.append(sign * place)
    for i in range(count - 1):
        for sign in (1, -1):
            row = np.zeros(len(cost))
            row[i + 1], row[i], row[count + count * len(places) + i] = sign, -sign, -1
            rows.append(row)
            limits.append(0.0)
    bounds = [(-1, 1)] * count + [(0, None)] * (len(cost) - count)
    found = linprog(cost, A_ub=np.array(rows), b_ub=limits, bounds=bounds, method="highs")
    return np.asarray(found.x[:count])


def least_energy(votes: np.ndarray, shape: tuple[int, int, int], strength: float) -> float:
    """Return the least energy of a field of this shape.

    It comes from a quasi-Newton search whose total variation is rounded less and less.
    """
    field = np.zeros(int(np.prod(shape)))

    def rounded(values: np.ndarray, size: float) -> float:
        grid = values.reshape(shape)
        steps = [np.diff(grid, axis=axis, append=grid.take([-1], axis)) for axis in range(3)]
        return float(misfit(values, votes).sum() + strength * np.sqrt(sum(step**2 for step in steps) + size**2).sum())

    for size in (0.1, 0.01, 0.001):
        field = minimize(rounded, field, args=(size,), method="L-BFGS-B", bounds=[(-1, 1)] * len(field)).x
    return energy(field.reshape(shape), votes, strength)


def vote(
    point: np.ndarray,
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    reach: float,
    solid: tuple[float, float],
    bins: int,
) -> np.ndarray:
    """Return the histogram [bins] of a point [3]; solid: the weight's share far behind a surface, and down to where."""
    histogram = np.zeros(bins)
    for camera, depth, weight in zip(cameras, depths, weights, strict=True):
        x, y, z = camera.cam_from_world[:3, :3] @ point + camera.cam_from_world[:3, 3]
        if z <= 0:
            continue
        column, row = (np.floor(each).astype(int) for each in (camera.K @ [x / z, y / z, 1])[:2])
        if not (0 <= column < camera.width and 0 <= row < camera.height):
            continue
        behind = (z - depth[row, column]) / reach
        if weight[row, column] > 0 and behind < solid[1]:
            share = 1 if behind < 1 else solid[0]
            histogram[min(max(int(np.floor((behind + 1) / 2 * bins)), 0), bins - 1)] += share * weight[row, column]
    return histogram
