"""Topology of triangle meshes, and removal of degenerate faces and small pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mgsr.geometry.mesh import Mesh


@dataclass(frozen=True)
class Topology:
    """Counts of a mesh's elements.

    boundary_edges: edges of a single face. holes: the loops that these form.
    """

    vertices: int
    faces: int
    components: int
    boundary_edges: int
    holes: int


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """Return vectors [P,3] with length 1; 0 stays 0."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))


def reflect(directions: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return directions [P,3], which point away from a surface with unit normals [P,3], reflected about the normals."""
    return np.asarray(2 * (directions * normals).sum(axis=1, keepdims=True) * normals - directions)


def tangents(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors [V,3] that are perpendicular to the unit normals [V,3] and to each other.

    Both are 0 where a normal is 0.
    """
    axis = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(axis, normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return across, np.cross(normals, across)


def boundary_loops(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the boundary edges [E,2] as vertex indices, in the orientation of their face, and the loop [E] of each.

    Loops that share a vertex count as one.
    """
    faces = mesh.faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, index, counts = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    boundary = edges[index[counts == 1]]
    if len(boundary) == 0:
        return boundary, np.zeros(0, np.int64)
    graph = coo_matrix((np.ones(len(boundary), bool), boundary.T), (boundary.max() + 1,) * 2)
    _, labels = connected_components(graph, directed=False)
    return boundary, np.unique(labels[boundary[:, 0]], return_inverse=True)[1]


def topology(mesh: Mesh) -> Topology:
    """Count a mesh's connected components, boundary edges and holes (`boundary_loops`)."""
    boundary, loops = boundary_loops(mesh)
    pieces = mesh.components[0] if len(mesh.faces) else 0
    return Topology(len(mesh.vertices), len(mesh.faces), pieces, len(boundary), len(np.unique(loops)))


def drop_degenerate(mesh: Mesh) -> Mesh:
    """Return the mesh without faces that repeat a vertex, have no area or are not finite."""
    areas = np.linalg.norm(mesh.face_crosses, axis=1)
    a, b, c = mesh.faces.T
    return mesh.keep_faces((a != b) & (b != c) & (c != a) & np.isfinite(areas) & (areas > 1e-14))


def drop_small_pieces(mesh: Mesh, min_area: float) -> Mesh:
    """Return the mesh without small connected components. The largest one always stays.

    min_area: the least area of a component, as a share of the whole mesh's area.
    """
    count, pieces = mesh.components
    areas = np.bincount(pieces, np.linalg.norm(mesh.face_crosses, axis=1), count)
    return mesh.keep_faces((areas >= min(min_area * areas.sum(), areas.max()))[pieces])
