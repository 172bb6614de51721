"""Mesh simplification by quadric edge collapse."""

from __future__ import annotations

import fast_simplification
import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import drop_degenerate


def decimate(mesh: Mesh, face_count: int) -> Mesh:
    """Reduce a mesh to about `face_count` faces. A mesh with no more faces is returned unchanged."""
    if len(mesh.faces) <= face_count:
        return mesh
    points, triangles = fast_simplification.simplify(
        mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), target_count=face_count
    )
    return drop_degenerate(Mesh(points.astype(np.float64), triangles.astype(np.int64)))


def coarser(mesh: Mesh, edge: float, max_faces: int) -> Mesh:
    """Simplify a mesh to edges of length `edge` or longer, and to `max_faces` faces at most.

    edge: in the vertices' unit. At least 1000 faces stay if the mesh has as many.
    """
    return decimate(mesh, min(max_faces, max(1000, round(mesh.area / (0.433 * edge**2)))))
