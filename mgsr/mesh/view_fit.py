"""Registration of a mesh to the surface that rendered views show.

The mesh keeps its faces. Both sides of a thin sheet therefore remain, unlike in an extraction from points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import MeshOptions
from mgsr.geometry.displace import integrate_normals
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.consistency import compare_views
from mgsr.mesh.pixels import PixelRules
from mgsr.mesh.points import OrientedPoints
from mgsr.mesh.views import SurfaceView


def fit_to_views(
    mesh: Mesh,
    views: Sequence[SurfaceView],
    rules: PixelRules,
    tolerance: float,
    threads: int | None = None,
    options: MeshOptions = MeshOptions(),
) -> Mesh:
    """Move a mesh along its normals to the surface on which the views' depths and normals agree.

    rules, tolerance: as for `compare_views`.
    """
    normals, fit = mesh.normals, options.view_fit
    points = OrientedPoints(mesh.vertices.astype(np.float32), normals)
    agreed = compare_views(points, views, rules, tolerance, threads, options.confirm_reach).moved
    offsets = ((agreed.positions - mesh.vertices) * normals).sum(axis=1)
    confirmed = np.abs(offsets) > 0
    alike = confirmed & ((agreed.normals * normals).sum(axis=1) > fit.min_cosine)
    moves = integrate_normals(
        mesh,
        np.where(alike[:, None], agreed.normals, normals),
        np.where(alike, 1, fit.confidence),
        1.0,
        prior_weight=np.where(confirmed, 1, fit.prior_weight),
        prior=np.where(confirmed, offsets, 0),
    )
    return mesh.moved(mesh.vertices + moves[:, None] * normals)
