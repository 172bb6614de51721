"""Normals from gloss: each normal is tilted until the environment map explains how its point's brightness changes.

The tilts are searched on a coarse grid, because lamps make the environment too uneven for gradient descent. A fine grid
around the best coarse tilt follows. A parabola between coarse steps would err by a few tenths of a degree, in the same
direction for all points of a flat face, which would then sag. The residual and its curvature on the coarse grid give
the confidence. The curvature at the fine grid's minimum is mostly noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from mgsr.config.expert import EnvironmentNormalOptions, EnvironmentOptions
from mgsr.geometry.displace import diffuse, mean_normals
from mgsr.geometry.triangles import tangents
from mgsr.native import _mirrored
from mgsr.native.structs import MirroredObservations
from mgsr.shading.environment_fit import FittedEnvironmentMap, fit_environment_map
from mgsr.shading.observations import Observations
from mgsr.shading.target_normals import TargetNormals


def normals_from_environment(
    observations: Observations,
    normals: np.ndarray,
    laplacian: sparse.csr_matrix,
    reach: float,
    still: np.ndarray,
    options: EnvironmentOptions = EnvironmentOptions(),
) -> TargetNormals:
    """Estimate the normals of a mesh's P vertices from one environment map that they all mirror.

    normals [P,3]: the mesh's unit normals. laplacian [P,P]: its uniform Laplacian (`Mesh.laplacian`). reach: the number
    of edges over which the costs of neighbours are pooled. still [P] in 0..1: 0 lets a normal tilt fully, 1 keeps it.
    """
    search, own = options.normals, mean_normals(normals, laplacian, rounds=1)
    environment = fit_environment_map(observations, own, options=options.fit)

    def best(around: np.ndarray, max_tilt: float, step: float, mean_cost: float | None) -> _Best:
        """Search tilts of the unit normals `around` [P,3]; mean_cost scales the cost of their tilts from `own`."""
        tilts = np.tan(np.radians(np.arange(-max_tilt, max_tilt + step / 2, step)))
        first, second = tangents(around)
        frames = np.stack([first, second, around], axis=1)
        costs = diffuse(_costs(observations, environment, frames, tilts, search), laplacian, reach)
        mean_cost = float(costs.mean()) if mean_cost is None else mean_cost
        costs += search.tilt_cost * mean_cost * _squared_tilts(frames, tilts, own) / np.tan(np.radians(10)) ** 2
        across, along, cost, bends = _lowest(costs.reshape(-1, len(tilts), len(tilts)), tilts)
        found = around + across[:, None] * first + along[:, None] * second
        found /= np.linalg.norm(found, axis=1, keepdims=True).clip(1e-9)
        return _Best(found, mean_cost, cost * (step**2 / np.maximum(bends, 1e-9)).sum(axis=0))

    coarse = best(own, search.max_tilt, search.step, None)
    fine = best(coarse.normals, search.step, search.fine_step, coarse.mean_cost)
    target = normals + (1 - still)[:, None] * (fine.normals - own)
    target /= np.linalg.norm(target, axis=1, keepdims=True).clip(1e-9)
    weights = diffuse(observations.weights.sum(axis=1)[:, None], laplacian, reach)[:, 0]
    variance = 2 * coarse.spread / np.maximum(weights, 1e-6)
    enough = observations.counts >= search.min_observations
    return TargetNormals(target, np.where(enough, 1 / (1 + variance / search.half_confidence**2), 0))


@dataclass(frozen=True)
class _Best:
    """The result of a search over a grid of tilts.

    normals [P,3]: unit. mean_cost: the mean of the costs on the grid. spread [P]: the least cost over the cost's
    curvature, in squared degrees.
    """

    normals: np.ndarray
    mean_cost: float
    spread: np.ndarray


def _squared_tilts(frames: np.ndarray, tilts: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the squared tangents [P,T*T] of the angles between the normals [P,3] and the tilted ones.

    frames [P,3,3], tilts [T]: as for `_costs`.
    """
    first, second, along = np.einsum("pai,pi->ap", frames, normals)
    across = tilts[:, None, None] * first + tilts[None, :, None] * second + along
    lengths = 1 + tilts[:, None] ** 2 + tilts[None] ** 2
    squares: np.ndarray = lengths[..., None] / np.maximum(across, 1e-3) ** 2 - 1
    return squares.reshape(-1, len(normals)).T


def _costs(
    observations: Observations,
    environment: FittedEnvironmentMap,
    frames: np.ndarray,
    tilts: np.ndarray,
    options: EnvironmentNormalOptions,
) -> np.ndarray:
    """Return the robust cost [P,T*T] of the residual for each tilt of the normals.

    frames [P,3,3]: rows of two tangents and the normal, unit. tilts [T]: tangents of the angles along each tangent.
    """
    read = MirroredObservations(
        view_directions=np.ascontiguousarray(observations.view_directions, np.float32),
        brightness=np.ascontiguousarray(observations.brightness, np.float32),
        weights=np.ascontiguousarray(observations.weights, np.float32),
    )
    outlier = options.outlier * environment.deviation + 1e-9
    costs = np.empty((len(frames), len(tilts), len(tilts)), np.float32)
    _mirrored.tilt_costs(
        read, environment.table(options.cells), frames.astype(np.float32), tilts.astype(np.float32), outlier, costs
    )
    return costs.reshape(len(frames), -1)


def _lowest(costs: np.ndarray, tilts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the tilts of least cost [P,T,T], with a parabola between the grid's steps; tilts [T].

    Returns the tilts [P] along each of two axes, the least cost [P] on the grid, and the cost's second differences
    [2,P] there along both axes. These are 0 at the border of the grid, beyond which the cost may be lower.
    """
    count, side = len(costs), len(tilts)
    place = costs.reshape(count, -1).argmin(axis=1)
    row, column, index = place // side, place % side, np.arange(count)
    here = costs[index, row, column]
    rows = [costs[index, np.clip(row + shift, 0, side - 1), column] for shift in (-1, 1)]
    columns = [costs[index, row, np.clip(column + shift, 0, side - 1)] for shift in (-1, 1)]
    steps = np.arange(side)
    across, along = (
        np.interp(steps[at] + _vertex(before, here, after), steps, tilts)
        for at, (before, after) in ((row, rows), (column, columns))
    )
    within = (row % (side - 1) > 0) & (column % (side - 1) > 0)
    return across, along, here, within * (np.stack([sum(rows), sum(columns)]) - 2 * here)


def _vertex(before: np.ndarray, here: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the vertex [P] of the parabola through three costs [P], in steps from the middle, -0.5..0.5."""
    bend = np.maximum(before + after - 2 * here, 1e-12)
    offsets: np.ndarray = np.clip((before - after) / (2 * bend), -0.5, 0.5)
    return offsets
