"""Normals, topology and selection of faces of triangle meshes, given as vertices [V,3] and faces [F,3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Triangles = tuple[np.ndarray, np.ndarray]  # vertices [V,3], faces [F,3]


@dataclass(frozen=True)
class Topology:
    """Counts of a mesh: connected components, edges with one face only, and the loops that these form (holes)."""

    vertices: int
    faces: int
    components: int
    boundary_edges: int
    holes: int


def face_crosses(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the face normals [F,3], as long as twice the face's area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals [V,3] float32, the area-weighted mean of the faces around; 0 for a vertex without a face."""
    crosses = face_crosses(vertices, faces)
    corners = faces.ravel()
    sums = np.stack([np.bincount(corners, np.repeat(crosses[:, axis], 3), len(vertices)) for axis in range(3)], axis=1)
    normals: np.ndarray = (sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-20)).astype(np.float32)
    return normals


def tangents(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors, [V,3] each, perpendicular to the unit normals [V,3] and to each other.

    Both are 0 where a normal is 0.
    """
    axis = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(axis, normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return across, np.cross(normals, across)


def face_components(faces: np.ndarray, vertex_count: int) -> tuple[int, np.ndarray]:
    """Count the connected components of the faces [F,3], and label each face with its own [F].

    Faces that share a vertex are connected.
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges), bool), edges.T), (vertex_count, vertex_count))
    _, labels = connected_components(graph, directed=False)
    used, pieces = np.unique(labels[faces[:, 0]], return_inverse=True)
    return len(used), pieces


def boundary_loops(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the boundary edges [E,2], in the direction of their one face, and the loop [E] of each.

    Loops that touch in a vertex count as one.
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, index, counts = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    rim = edges[index[counts == 1]]
    if len(rim) == 0:
        return rim, np.zeros(0, np.int64)
    graph = coo_matrix((np.ones(len(rim), bool), rim.T), (rim.max() + 1,) * 2)
    _, labels = connected_components(graph, directed=False)
    return rim, np.unique(labels[rim[:, 0]], return_inverse=True)[1]


def topology(vertices: np.ndarray, faces: np.ndarray) -> Topology:
    """Count a mesh's connected components, boundary edges and holes (`boundary_loops`)."""
    rim, loops = boundary_loops(faces)
    pieces = face_components(faces, len(vertices))[0] if len(faces) else 0
    return Topology(len(vertices), len(faces), pieces, len(rim), len(np.unique(loops)))


def keep_faces(vertices: np.ndarray, faces: np.ndarray, keep: np.ndarray) -> Triangles:
    """Return the mesh of the faces where keep [F] is True, without the vertices that no face uses any more."""
    faces = faces[keep]
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3)


def drop_degenerate(vertices: np.ndarray, faces: np.ndarray) -> Triangles:
    """Return the mesh without faces that repeat a vertex, have no area or are not finite."""
    areas = np.linalg.norm(face_crosses(vertices, faces), axis=1)
    a, b, c = faces.T
    return keep_faces(vertices, faces, (a != b) & (b != c) & (c != a) & np.isfinite(areas) & (areas > 1e-14))


def drop_small_pieces(vertices: np.ndarray, faces: np.ndarray, min_area: float) -> Triangles:
    """Return the mesh without connected components of less than the share `min_area` of the whole area.

    The largest one always stays.
    """
    count, pieces = face_components(faces, len(vertices))
    areas = np.bincount(pieces, np.linalg.norm(face_crosses(vertices, faces), axis=1), count)
    return keep_faces(vertices, faces, (areas >= min(min_area * areas.sum(), areas.max()))[pieces])
