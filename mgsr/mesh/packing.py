"""Packing of flat charts into a texture atlas.

xatlas packs the charts. It leaves out flat faces, which have next to no area in the plane, such as those that a chart
shows edge-on. A vertex that only such faces have would stay where it is, and its faces would cross the whole atlas.
Here the solid faces that share vertices form islands, which xatlas moves as a whole, and each flat face moves with one
island.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mgsr.config.expert import UnwrapOptions
from mgsr.geometry.charts import Charts


@dataclass(frozen=True)
class Atlas:
    """Charts in one picture.

    origin [V]: the charts' vertex of each vertex, which is repeated where a flat face joins two islands. faces [F,3]:
    of these vertices, in the charts' order. places [V,2]: in texels from the upper left corner. size: the picture's
    height and width in texels.
    """

    origin: np.ndarray
    faces: np.ndarray
    places: np.ndarray
    size: tuple[int, int]


def pack_charts(
    charts: Charts, texel: float, width: int | None = None, options: UnwrapOptions = UnwrapOptions()
) -> Atlas:
    """Pack charts into one atlas.

    texel: the size of a texel in the charts' unit. width: the approximate width of the atlas in texels, whose size is
    then chosen to fit.
    """
    import xatlas  # imported here, because nothing else needs it

    places = (charts.places / texel).astype(np.float32)
    atlas = xatlas.Atlas()
    atlas.add_uv_mesh(places, charts.faces.astype(np.uint32))
    pack = xatlas.PackOptions()
    pack.padding, pack.bilinear = options.padding, True
    if width is None:
        pack.texels_per_unit = 1
    else:
        pack.resolution = width
    atlas.generate(xatlas.ChartOptions(), pack)
    origin, _, uvs = atlas[0]
    packed = np.zeros((len(places), 2))
    packed[origin] = uvs * np.array([atlas.width, atlas.height])
    vertices, faces, moved = _with_islands(places.astype(np.float64), charts.faces, packed, options.flat)
    return Atlas(vertices, faces, moved, (atlas.height, atlas.width))


def _with_islands(
    places: np.ndarray, faces: np.ndarray, packed: np.ndarray, flat: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Let each flat face move with an island.

    places [W,2], packed [W,2]: the charts' vertices before packing and after it, where only vertices of solid faces are
    right. flat: `UnwrapOptions.flat`.

    Returns for each new vertex the charts' vertex [V], the faces [F,3] of new vertices, and their places [V,2].
    """
    solid = _are_solid(places[faces], flat)
    count = len(places)
    first, second, third = faces[solid].T
    edges = np.concatenate([first, first]), np.concatenate([second, third])
    graph = sparse.coo_matrix((np.ones(len(edges[0]), bool), edges), (count, count))
    islands: np.ndarray = connected_components(graph, directed=False)[1].astype(np.int64)
    known = np.zeros(count, bool)
    known[faces[solid]] = True
    if not known.any():
        return np.arange(count), faces, packed
    _, nearest = cKDTree(places[known]).query(places[~known])
    islands[~known] = islands[known][nearest]
    numbers, islands = np.unique(islands, return_inverse=True)
    # Flat faces move with the island of their first vertex; solid faces have only one.
    keys, new_faces = np.unique(islands[faces[:, :1]] * count + faces, return_inverse=True)
    island, origin = np.divmod(keys, count)
    stays = known[origin] & (islands[origin] == island)
    motion = _Motion.of_islands(places[known], packed[known], islands[known], len(numbers))
    moved = motion.moved(places[origin], island)
    return origin, new_faces.reshape(-1, 3), np.where(stays[:, None], packed[origin], moved)


def _are_solid(corners: np.ndarray, flat: float) -> np.ndarray:
    """Return which triangles [F] bool are not flat, given their corners [F,3,2] in texels."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    return np.asarray(area > flat * np.maximum(longest, 1))


@dataclass(frozen=True)
class _Motion:
    """The motion of each island: its middle before and after packing, [K,2] each, and its turn [K,2,2].

    xatlas may mirror an island. All islands have one scale.
    """

    before: np.ndarray
    after: np.ndarray
    turn: np.ndarray
    scale: float

    @classmethod
    def of_islands(cls, places: np.ndarray, packed: np.ndarray, islands: np.ndarray, count: int) -> _Motion:
        """Find the motion of `count` islands [P] from their vertices before packing, places [P,2], and packed [P,2]."""

        def summed(values: np.ndarray) -> np.ndarray:
            return np.stack([np.bincount(islands, each, count) for each in values.T], axis=1)

        number = np.maximum(np.bincount(islands, minlength=count), 1)[:, None]
        before, after = summed(places) / number, summed(packed) / number
        near, far = places - before[islands], packed - after[islands]
        products = summed((far[:, :, None] * near[:, None, :]).reshape(-1, 4)).reshape(-1, 2, 2)
        left, _, right = np.linalg.svd(products)
        scale = float(np.sqrt((far**2).sum() / max((near**2).sum(), 1e-30)))
        return cls(before, after, left @ right, scale)

    def moved(self, places: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return places [P,2] after the motion of their islands [P]."""
        about = np.einsum("pij,pj->pi", self.turn[islands], places - self.before[islands])
        return np.asarray(self.after[islands] + self.scale * about)
