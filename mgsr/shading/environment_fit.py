"""Estimation of the environment map that a surface mirrors, blurred by the surface's gloss.

Under static light, a point's brightness is the sum of a constant diffuse term and a mirrored term. If the gloss is the
same everywhere, the mirrored term depends on the mirrored direction alone. So all points together determine one map,
and the change of a point's brightness between views determines its normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import LinearOperator, cg

from mgsr.config.expert import EnvironmentFitOptions
from mgsr.data.robust import robust_deviation
from mgsr.geometry.triangles import reflect
from mgsr.shading.observations import Observations

TOLERANCE, MOST_STEPS = 1e-3, 100  # of the conjugate gradients: relative residual at which they end, and most steps


@dataclass(frozen=True)
class FittedEnvironmentMap:
    """An environment map fitted to observations.

    light [H,2H]: float32 linear light, up to a constant; rows are polar angles, columns azimuths.
    deviation: the root mean square residual of the observations, in linear light.
    ratio: `deviation` divided by the observations' deviation from each point's mean brightness, which needs no map.
    """

    light: np.ndarray
    deviation: float
    ratio: float

    def table(self, cells: int) -> np.ndarray:
        """Return the light in the directions of the cells of the cube [-1,1]^3, [cells,cells,cells] float32.

        The table is read without computing angles. Its axes are x, y and z.
        """
        middles = (np.arange(cells, dtype=np.float32) + 0.5) * (2 / cells) - 1
        places = np.stack(np.meshgrid(middles, middles, middles, indexing="ij"), axis=-1)
        rows, columns = _places(places / np.linalg.norm(places, axis=-1, keepdims=True), len(self.light))
        wide = np.concatenate([self.light[:, -1:], self.light, self.light[:, :1]], axis=1)
        values: np.ndarray = map_coordinates(wide, [rows, columns + 1], order=1, mode="nearest")
        return values

    def mirrored(self, normals: np.ndarray, view_directions: np.ndarray) -> np.ndarray:
        """Return the light [P] that points with unit normals [P,3] mirror to unit directions view_directions [P,3]."""
        directions = reflect(view_directions, normals)
        return np.asarray(sample_map(directions, len(self.light)) @ self.light.ravel())


def fit_environment_map(
    observations: Observations,
    normals: np.ndarray,
    seed: int = 0,
    options: EnvironmentFitOptions = EnvironmentFitOptions(),
) -> FittedEnvironmentMap:
    """Fit the environment map that best explains the observations of points with unit normals [P,3].

    The fit is robust least squares over at most `options.points` points, drawn with `seed`.
    """
    points, seen = _well_read(observations, seed, options)
    view_directions, brightness, weights = (
        observations.view_directions[points],
        observations.brightness[points],
        observations.weights[points],
    )
    owners = np.nonzero(seen)[0]
    own, eye = normals[points][owners], view_directions[seen]
    rows = sample_map(reflect(eye, own), options.height)
    equations = _EnvironmentEquations(rows, brightness[seen].astype(float), owners, options)
    given = weights[seen].astype(float)
    light, current = np.zeros(rows.shape[1]), given
    for _ in range(options.rounds):
        light = equations.solve(current, light)
        residual = equations.residual(light, current)
        spread = robust_deviation(residual) + 1e-9
        current = given / (1 + (residual / (options.outlier * spread)) ** 2)
    deviation = _deviation(residual, given)
    plain = _deviation(equations.residual(np.zeros_like(light), given), given)
    return FittedEnvironmentMap(
        light.reshape(options.height, -1).astype(np.float32), deviation, deviation / max(plain, 1e-9)
    )


@dataclass(frozen=True)
class _EnvironmentEquations:
    """The linear equations of the map: brightness [Q] = rows [Q,C] @ light [C] + diffuse brightness.

    owners [Q]: the point of each observation. A point's diffuse brightness is the same in all its observations.
    """

    rows: sparse.csr_matrix
    brightness: np.ndarray
    owners: np.ndarray
    options: EnvironmentFitOptions

    def solve(self, weights: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return the weighted least-squares map [C]; weights [Q]; start [C]: the first guess."""
        smooth = self.options.smoothness * weights.sum() / self.rows.shape[1] * steps_squared(self.options.height)
        turned = self.rows.T.tocsr()

        def apply(light: np.ndarray) -> np.ndarray:
            """Return the normal equations' left side [HEIGHT*WIDTH] of a map [HEIGHT*WIDTH]."""
            data = turned @ (weights * self._without_own(self.rows @ light, weights))
            applied: np.ndarray = data + smooth @ light + 1e-6 * light
            return applied

        size = self.rows.shape[1]
        right = turned @ (weights * self._without_own(self.brightness, weights))
        system = LinearOperator((size, size), matvec=apply, dtype=float)
        solution: np.ndarray = cg(system, right, x0=start, rtol=TOLERANCE, maxiter=MOST_STEPS)[0]
        return solution

    def residual(self, light: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the residuals [Q] of a map `light` [C], with each point's diffuse brightness by weights [Q]."""
        return self._without_own(self.brightness - self.rows @ light, weights)

    def _without_own(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return values [Q] minus their weighted mean for each point; weights [Q]."""
        means = np.bincount(self.owners, weights * values) / np.maximum(np.bincount(self.owners, weights), 1e-12)
        centred: np.ndarray = values - means[self.owners]
        return centred


def _well_read(observations: Observations, seed: int, options: EnvironmentFitOptions) -> tuple[np.ndarray, np.ndarray]:
    """Draw points that at least `options.min_observations` photographs see.

    Returns their indices [Q], and which of their observations have weight, [Q,K] bool.
    """
    points = np.flatnonzero(observations.counts >= options.min_observations)
    if len(points) > options.points:
        points = np.sort(np.random.default_rng(seed).choice(points, options.points, replace=False))
    return points, observations.weights[points] > 0


def _places(directions: np.ndarray, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the row and column, [...] each, in a map of height x 2 height cells for unit directions [...,3].

    Cell centres are integers.
    """
    polar = np.arccos(np.clip(directions[..., 2], -1, 1)) / np.pi
    azimuth = np.arctan2(directions[..., 1], directions[..., 0]) / (2 * np.pi) % 1
    return polar * height - 0.5, azimuth * (2 * height) - 0.5


def cell_directions(height: int) -> np.ndarray:
    """Return the unit directions [height,2*height,3] of the cells of a map, in the order of `sample_map`."""
    polar, azimuth = np.meshgrid(
        (np.arange(height) + 0.5) / height * np.pi, (np.arange(2 * height) + 0.5) / height * np.pi, indexing="ij"
    )
    flat = np.sin(polar)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.cos(polar)], axis=-1)


def sample_map(directions: np.ndarray, height: int) -> sparse.csr_matrix:
    """Return the matrix [Q,2*height^2] that samples a map of height x 2 height cells bilinearly.

    directions [Q,3]: unit. Rows of the map are polar angles from z, columns are azimuths from x.
    """
    width = 2 * height
    rows, columns = _places(directions, height)
    top, first = np.floor(rows).astype(int), np.floor(columns).astype(int)
    down, along = rows - top, columns - first
    cells, shares = [], []
    for row, row_share in ((top, 1 - down), (top + 1, down)):
        for column, column_share in ((first, 1 - along), (first + 1, along)):
            cells.append(np.clip(row, 0, height - 1) * width + column % width)
            shares.append(row_share * column_share)
    places = (np.tile(np.arange(len(rows)), 4), np.concatenate(cells))
    return sparse.coo_matrix((np.concatenate(shares), places), (len(rows), height * width)).tocsr()


def steps_squared(height: int) -> sparse.csr_matrix:
    """Return the quadratic form of the differences of neighbouring cells in a map of height x 2 height cells.

    The map wraps around in azimuth.
    """
    cells = np.arange(2 * height**2).reshape(height, 2 * height)
    pairs = np.concatenate(
        [
            np.stack([cells.ravel(), np.roll(cells, -1, axis=1).ravel()], 1),
            np.stack([cells[:-1].ravel(), cells[1:].ravel()], 1),
        ]
    )
    count = len(pairs)
    ends = (np.tile(np.arange(count), 2), pairs.T.ravel())
    steps = sparse.coo_matrix((np.repeat([1.0, -1.0], count), ends), (count, cells.size)).tocsr()
    return (steps.T @ steps).tocsr()


def _deviation(residual: np.ndarray, weights: np.ndarray) -> float:
    """Return the weighted root mean square of residuals [Q]; weights [Q]."""
    return float(np.sqrt((weights * residual * residual).sum() / max(weights.sum(), 1e-12)))
