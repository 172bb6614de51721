"""Registration of a mesh to the surface that rendered views show.

The mesh keeps its faces. So, unlike an extraction from points, both sides of a thin sheet stay.
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

PRIOR_WEIGHT = 0.02  # of the position of a vertex that no view confirms; 1 for others
CONFIDENCE = 0.1  # in the normal of a vertex without a similar normal in the views; 1 for others
MIN_COSINE = 0.3  # least cosine between the normals of a vertex and of the views' surface to count as similar


def fit_to_views(
    mesh: Mesh, views: Sequence[SurfaceView], rules: PixelRules, tolerance: float, threads: int | None = None
) -> Mesh:
    """Move a mesh along its normals to the surface on which the views' depths and normals agree.

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
