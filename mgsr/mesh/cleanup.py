"""What is done to a raw surface: pull it into the silhouettes, drop what no camera sees, orient and decimate it."""

from __future__ import annotations

from collections.abc import Sequence

import fast_simplification
import numpy as np

from mgsr.data.camera import Camera
from mgsr.mesh.consistency import Hull
from mgsr.mesh.surface import face_components, face_crosses, keep_faces, vertex_normals
from mgsr.metrics.raycast import RayCaster

Triangles = tuple[np.ndarray, np.ndarray]  # vertices [V,3], faces [F,3]


def pull_into_hull(vertices: np.ndarray, faces: np.ndarray, hull: Hull, margin: float, reach: float) -> Triangles:
    """Move vertices that lie outside a silhouette inwards along their normals; cut off the faces that would have to
    move more than `reach`. margin: pixels outside a silhouette that are forgiven."""
    keep = hull.excess(vertices, margin) <= reach
    vertices, faces = keep_faces(vertices, faces, keep[faces].all(1))
    for _ in range(3):
        # At a silhouette the normal lies in the image plane, so the excess there is the distance along the normal.
        normals = vertex_normals(vertices, faces)
        vertices = vertices - normals * hull.excess(vertices, margin)[:, None]
    return vertices, faces


def drop_degenerate(vertices: np.ndarray, faces: np.ndarray) -> Triangles:
    """The mesh without faces that repeat a vertex, have no area or are not finite."""
    areas = np.linalg.norm(face_crosses(vertices, faces), axis=1)
    a, b, c = faces.T
    return keep_faces(vertices, faces, (a != b) & (b != c) & (c != a) & np.isfinite(areas) & (areas > 1e-14))


def seen_by(vertices: np.ndarray, faces: np.ndarray, cameras: Sequence[Camera], gap: float) -> np.ndarray:
    """Which vertices each camera sees, [C,V] bool; `gap` forgives what lies that close before a vertex."""
    caster = RayCaster(vertices, faces)
    return np.stack([caster.sees(camera, vertices, gap) for camera in cameras])


def facing(vertices: np.ndarray, faces: np.ndarray, cameras: Sequence[Camera], seen: np.ndarray) -> np.ndarray:
    """By how many of the cameras that see it [C,V] each vertex is seen from its front, less from its back; [V]."""
    normals = vertex_normals(vertices, faces)
    score = np.zeros(len(vertices), np.int32)
    for camera, visible in zip(cameras, seen, strict=True):
        score += np.where(visible, np.sign(((camera.center - vertices) * normals).sum(1)), 0).astype(np.int32)
    return score


def turn_outwards(faces: np.ndarray, score: np.ndarray) -> np.ndarray:
    """The faces with every piece turned round whose vertices are mostly seen from the back (`facing`)."""
    count, pieces = face_components(faces, len(score))
    votes = np.bincount(pieces, score[faces].sum(1), count)
    return np.where((votes < 0)[pieces][:, None], faces[:, ::-1], faces)


def drop_small_pieces(vertices: np.ndarray, faces: np.ndarray, min_area: float) -> Triangles:
    """The mesh without the connected pieces under `min_area` of the whole area; the largest always stays."""
    count, pieces = face_components(faces, len(vertices))
    areas = np.bincount(pieces, np.linalg.norm(face_crosses(vertices, faces), axis=1), count)
    return keep_faces(vertices, faces, (areas >= min(min_area * areas.sum(), areas.max()))[pieces])


def drop_unseen(vertices: np.ndarray, faces: np.ndarray, seen: np.ndarray, whole_pieces: bool) -> Triangles:
    """The mesh without what no camera sees (seen [V] bool): floaters' insides, inner shells, invented caps.

    whole_pieces: keep every face of a piece that is seen somewhere, so that closed surfaces stay closed.
    """
    if whole_pieces:
        count, pieces = face_components(faces, len(vertices))
        visible = np.bincount(pieces, seen[faces].any(1), count) > 0
        return keep_faces(vertices, faces, visible[pieces])
    ring = _grown(_grown(seen, faces), faces)
    return keep_faces(vertices, faces, ring[faces].all(1))


def _grown(marked: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The marked vertices [V] and their neighbours: creases hide single vertices of a surface that is seen."""
    grown = marked.copy()
    grown[faces[marked[faces].any(1)]] = True
    return grown


def decimate(vertices: np.ndarray, faces: np.ndarray, face_count: int) -> Triangles:
    """The mesh reduced to about `face_count` faces by quadric edge collapse; unchanged if it has no more."""
    if len(faces) <= face_count:
        return vertices, faces
    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_count=face_count
    )
    return drop_degenerate(points.astype(np.float64), triangles.astype(np.int64))
