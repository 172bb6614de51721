"""One cloud of oriented points from all rendered views, thinned by averaging in cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.vectors import dots
from mgsr.mesh.pixels import PixelRules, surface_pixels
from mgsr.mesh.views import SurfaceView
from mgsr.parallel import map_ahead


@dataclass(frozen=True)
class OrientedPoints:
    """A point cloud: positions [P,3] and unit outward normals [P,3], float32, in the scene's frame."""

    positions: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    def where(self, keep: np.ndarray) -> OrientedPoints:
        """Return the points where keep [P] bool is True."""
        return OrientedPoints(self.positions[keep], self.normals[keep])

    def joined(self, other: OrientedPoints) -> OrientedPoints:
        """Return these points followed by the other's."""
        positions = np.concatenate([self.positions, other.positions])
        return OrientedPoints(positions, np.concatenate([self.normals, other.normals]))

    def near(self, places: np.ndarray, reach: float) -> np.ndarray:
        """Return the places [Q,3] that have a point within `reach`, in the scene's unit: [Q] bool."""
        distances, _ = cKDTree(self.positions).query(places, distance_upper_bound=reach, workers=-1)
        near: np.ndarray = np.isfinite(distances)
        return near


@dataclass(frozen=True)
class CellSums:
    """Weighted sums of points in cubic cells.

    keys [R]: int64, ascending. sums [R,7]: of weight * position, weight * normal, and weight. Normals along the six
    axis directions have separate keys in a cell. Only the merged sums show which directions belong to opposite sides of
    a thin wall and must not be averaged.
    """

    keys: np.ndarray
    sums: np.ndarray

    @staticmethod
    def of(points: OrientedPoints, weights: np.ndarray, cell: float) -> CellSums:
        """Sum points with weights [P] in cubic cells; cell: their side, in the scene's unit."""
        columns = np.concatenate([points.positions, points.normals, np.ones_like(points.positions[:, :1])], axis=1)
        return CellSums(*_sum_by_key(_cell_keys(points, cell), columns * weights[:, None]))

    @staticmethod
    def merged(parts: Sequence[CellSums]) -> CellSums:
        """Merge the sums of several parts."""
        keys, sums = [part.keys for part in parts], [part.sums for part in parts]
        return CellSums(*_sum_by_key(np.concatenate(keys), np.concatenate(sums)))

    def mean(self) -> OrientedPoints:
        """Return each cell's weighted mean, and a second point for normals that oppose the heaviest direction."""
        _, sums = _sum_by_key(self.keys // 6 * 2 + self._opposed(), self.sums)
        lengths = np.linalg.norm(sums[:, 3:6], axis=1, keepdims=True)
        return OrientedPoints(sums[:, :3] / sums[:, 6:], sums[:, 3:6] / np.maximum(lengths, 1e-12))

    def _opposed(self) -> np.ndarray:
        """Return which sums [R] bool have a normal that opposes the heaviest direction of their cell."""
        cells = self.keys // 6
        order = np.lexsort([-self.sums[:, 6], cells])
        first, inverse = np.unique(cells, return_inverse=True)
        heaviest = order[np.searchsorted(cells[order], first)]
        opposed: np.ndarray = (self.sums[:, 3:6] * self.sums[heaviest[inverse], 3:6]).sum(1) < 0
        return opposed


def _cell_keys(points: OrientedPoints, cell: float) -> np.ndarray:
    """Return each point's key [P] int64: its cell, and the axis direction closest to its normal."""
    # 20 bits an axis reach half a million cells each way; beyond that, points share the outermost cells.
    cells = np.clip(np.floor(points.positions / cell).astype(np.int64) + (1 << 19), 0, (1 << 20) - 1)
    axis = np.abs(points.normals).argmax(1)
    side = np.take_along_axis(points.normals, axis[:, None], 1)[:, 0] > 0
    packed = (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]
    keys: np.ndarray = packed * 6 + axis * 2 + side
    return keys


def _sum_by_key(keys: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum rows [P,D] with equal keys [P]; return the distinct keys [R], ascending, and the sums [R,D]."""
    if len(keys) == 0:
        return keys, rows
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[starts], np.add.reduceat(rows[order], starts, axis=0)


def gather_points(
    views: Sequence[SurfaceView], cell: float, rules: PixelRules, threads: int | None = None
) -> OrientedPoints:
    """Average the reliable points of all views in cubic cells; points seen head-on weigh more.

    cell: the cells' side, in the scene's unit.
    """

    def sums_of(view: SurfaceView) -> CellSums:
        pixels = surface_pixels(view, rules)
        keep = pixels.believed
        return CellSums.of(OrientedPoints(pixels.positions[keep], pixels.normals[keep]), pixels.cosines[keep], cell)

    return CellSums.merged(list(map_ahead(sums_of, views, threads))).mean()


def missing_points(points: OrientedPoints, surface: Mesh, cell: float, reach: float) -> OrientedPoints:
    """Return the points of a surface that have none of the given points within `reach`.

    cell: the side of the cubic cells in which the surface's vertices are averaged. Both lengths are in the scene's
    unit.
    """
    vertices = OrientedPoints(surface.vertices.astype(np.float32), surface.normals.astype(np.float32))
    found = CellSums.of(vertices, np.ones(len(vertices), np.float32), cell).mean()
    return found.where(~points.near(found.positions, reach))


def front_views(points: OrientedPoints, surface: Mesh, views: Sequence[SurfaceView], gap: float) -> np.ndarray:
    """Return the number of views, [P], that see each point of a surface from the front.

    gap: the distance before a point, in the scene's unit, within which nothing occludes it.
    """
    count = np.zeros(len(points), np.int32)
    for view in views:
        front = dots(view.camera.center - points.positions, points.normals) > 0
        count += front & surface.caster.sees(view.camera, points.positions, gap, view.mask)
    return count
