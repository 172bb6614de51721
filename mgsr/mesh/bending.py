"""A mesh bent to the surface that views show, with its own faces kept.

Unlike an extraction from points, it keeps both sides of a sheet that is thinner than the extraction's cells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.geometry.displace import bend_to_normals, edges
from mgsr.geometry.triangles import vertex_normals
from mgsr.mesh.consistency import compare_views
from mgsr.mesh.pixels import PixelRules
from mgsr.mesh.points import OrientedPoints
from mgsr.mesh.views import SurfaceView

STAY = 0.02  # weight of the place of a vertex of which no view tells, where a view's is 1
UNKNOWN = 0.1  # trust in the normal of such a vertex, where a view's is 1
TURNED = 0.3  # least cosine between the normals of a vertex and of the views' surface there


def bend_to_views(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[SurfaceView],
    rules: PixelRules,
    tolerance: float,
    threads: int | None = None,
) -> np.ndarray:
    """Return the vertices [V,3] moved along their normals to where the views' depths and normals agree.

    rules, tolerance: as for `compare_views`.
    """
    normals = vertex_normals(vertices, faces)
    points = OrientedPoints(vertices.astype(np.float32), normals)
    moved = compare_views(points, views, rules, tolerance, threads).moved
    offsets = ((moved.positions - vertices) * normals).sum(axis=1)
    told = np.abs(offsets) > 0
    sure = told & ((moved.normals * normals).sum(axis=1) > TURNED)
    moves = bend_to_normals(
        vertices,
        edges(faces),
        normals.astype(np.float64),
        np.where(sure[:, None], moved.normals, normals),
        np.where(sure, 1, UNKNOWN),
        1.0,
        hold=np.where(told, 1, STAY),
        offsets=np.where(told, offsets, 0),
    )
    bent: np.ndarray = vertices + moves[:, None] * normals
    return bent
