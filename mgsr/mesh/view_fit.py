"""A mesh moved to the surface that views show, with its own faces kept.

Unlike an extraction from points, it keeps both sides of a sheet that is thinner than the extraction's cells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.geometry.displace import integrate_normals
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.consistency import compare_views
from mgsr.mesh.pixels import PixelRules
from mgsr.mesh.points import OrientedPoints
from mgsr.mesh.views import SurfaceView

PRIOR_WEIGHT = 0.02  # of the place of a vertex that no view confirms, where a view's is 1
CONFIDENCE = 0.1  # in the normal of such a vertex, where a view's is 1
MIN_COSINE = 0.3  # between the normals of a vertex and of the views' surface there


def fit_to_views(
    mesh: Mesh, views: Sequence[SurfaceView], rules: PixelRules, tolerance: float, threads: int | None = None
) -> Mesh:
    """Return the mesh moved along its normals to where the views' depths and normals agree.

    rules, tolerance: as for `compare_views`.
    """
    normals = mesh.normals
    points = OrientedPoints(mesh.vertices.astype(np.float32), normals)
    agreed = compare_views(points, views, rules, tolerance, threads).moved
    offsets = ((agreed.positions - mesh.vertices) * normals).sum(axis=1)
    told = np.abs(offsets) > 0
    alike = told & ((agreed.normals * normals).sum(axis=1) > MIN_COSINE)
    moves = integrate_normals(
        mesh,
        np.where(alike[:, None], agreed.normals, normals),
        np.where(alike, 1, CONFIDENCE),
        1.0,
        prior_weight=np.where(told, 1, PRIOR_WEIGHT),
        prior=np.where(told, offsets, 0),
    )
    return mesh.moved(mesh.vertices + moves[:, None] * normals)
