"""Rendered views as one cloud of oriented points, thinned by averaging in cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.mesh.pixels import PixelRules, surface_pixels
from mgsr.mesh.views import SurfaceView


@dataclass(frozen=True)
class OrientedPoints:
    """positions [P,3] and unit outward normals [P,3], float32, in the scene's frame."""

    positions: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    def where(self, keep: np.ndarray) -> OrientedPoints:
        """The points where keep [P] is True."""
        return OrientedPoints(self.positions[keep], self.normals[keep])


class CellSums:
    """Points gathered in cubic cells of a given size, weighted; the two sides of a thin wall are kept apart."""

    def __init__(self, cell: float) -> None:
        self._cell = cell
        self._keys = np.zeros(0, np.int64)
        self._sums = np.zeros((0, 7))

    def add(self, points: OrientedPoints, weights: np.ndarray) -> None:
        """Add points with weights [P]."""
        columns = np.concatenate([points.positions, points.normals, np.ones((len(points), 1))], axis=1)
        keys = np.concatenate([self._keys, self._key(points)])
        self._keys, self._sums = _sum_by_key(keys, np.concatenate([self._sums, columns * weights[:, None]]))

    # Six main directions are gathered apart: which of them are the wall's two sides shows only in the end.
    def _key(self, points: OrientedPoints) -> np.ndarray:
        # 20 bits an axis reach a million cells; what lies outside was cut off by the caller's radius or is far away.
        cells = np.clip(np.floor(points.positions / self._cell).astype(np.int64) + (1 << 19), 0, (1 << 20) - 1)
        axis = np.abs(points.normals).argmax(1)
        side = np.take_along_axis(points.normals, axis[:, None], 1)[:, 0] > 0
        packed = (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]
        return packed * 6 + axis * 2 + side

    def mean(self) -> OrientedPoints:
        """The weighted means of each cell: one point, and a second where normals point against the first's."""
        _, sums = _sum_by_key(self._keys // 6 * 2 + self._opposed(), self._sums)
        lengths = np.linalg.norm(sums[:, 3:6], axis=1, keepdims=True)
        return OrientedPoints(
            (sums[:, :3] / sums[:, 6:]).astype(np.float32),
            (sums[:, 3:6] / np.maximum(lengths, 1e-12)).astype(np.float32),
        )

    def _opposed(self) -> np.ndarray:
        """Which of the gathered directions point against the heaviest one of their cell."""
        cells = self._keys // 6
        order = np.lexsort([-self._sums[:, 6], cells])
        first, inverse = np.unique(cells, return_inverse=True)
        heaviest = order[np.searchsorted(cells[order], first)]
        return (self._sums[:, 3:6] * self._sums[heaviest[inverse], 3:6]).sum(1) < 0


def _sum_by_key(keys: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct keys, sorted, and the sums of their rows."""
    if len(keys) == 0:
        return keys, rows
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[starts], np.add.reduceat(rows[order], starts, axis=0)


def gather_points(views: Sequence[SurfaceView], cell: float, rules: PixelRules) -> OrientedPoints:
    """All views' believable points, averaged in cells of the given size; what is seen head-on counts more."""
    sums = CellSums(cell)
    for view in views:
        pixels = surface_pixels(view, rules)
        keep = pixels.believed
        sums.add(OrientedPoints(pixels.positions[keep], pixels.normals[keep]), pixels.cosines[keep])
    return sums.mean()
