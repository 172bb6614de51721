"""Mesh simplification by quadric edge collapse."""

from __future__ import annotations

import fast_simplification
import numpy as np

from mgsr.geometry.triangles import Triangles, drop_degenerate, face_crosses

MAX_FACES = 150_000  # of a mesh that is coarse enough to work on


def decimate(vertices: np.ndarray, faces: np.ndarray, face_count: int) -> Triangles:
    """Reduce a mesh to about `face_count` faces by quadric edge collapse.

    Returns vertices [V',3] and faces [F',3]; the mesh itself, unchanged, where it has no more faces than that.
    """
    if len(faces) <= face_count:
        return vertices, faces
    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_count=face_count
    )
    return drop_degenerate(points.astype(np.float64), triangles.astype(np.int64))


def coarser(vertices: np.ndarray, faces: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Simplify a mesh to edges of length `edge` or longer, and to MAX_FACES faces at most.

    vertices [V,3]; faces [F,3]; edge: in the vertices' unit. The mesh keeps at least 1000 faces, where it has as many.
    """
    area = np.linalg.norm(face_crosses(vertices, faces), axis=1).sum() / 2
    return decimate(vertices, faces, min(MAX_FACES, max(1000, round(area / (0.433 * edge**2)))))
