"""A mesh with fewer faces."""

from __future__ import annotations

import fast_simplification
import numpy as np

from mgsr.geometry.triangles import Triangles, drop_degenerate, face_crosses

MAX_FACES = 150_000  # of a mesh that is coarse enough to work on


def decimate(vertices: np.ndarray, faces: np.ndarray, face_count: int) -> Triangles:
    """The mesh reduced to about `face_count` faces by quadric edge collapse; unchanged if it has no more."""
    if len(faces) <= face_count:
        return vertices, faces
    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_count=face_count
    )
    return drop_degenerate(points.astype(np.float64), triangles.astype(np.int64))


def coarser(vertices: np.ndarray, faces: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with edges of about this length or longer, and MAX_FACES at most."""
    area = np.linalg.norm(face_crosses(vertices, faces), axis=1).sum() / 2
    return decimate(vertices, faces, min(MAX_FACES, max(1000, round(area / (0.433 * edge**2)))))
