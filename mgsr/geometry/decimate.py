"""A mesh with fewer faces."""

from __future__ import annotations

import fast_simplification
import numpy as np

from mgsr.geometry.triangles import Triangles, drop_degenerate


def decimate(vertices: np.ndarray, faces: np.ndarray, face_count: int) -> Triangles:
    """The mesh reduced to about `face_count` faces by quadric edge collapse; unchanged if it has no more."""
    if len(faces) <= face_count:
        return vertices, faces
    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_count=face_count
    )
    return drop_degenerate(points.astype(np.float64), triangles.astype(np.int64))
