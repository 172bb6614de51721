"""Vertices moved to where data wants them, and smoothly in between; and vertices smoothed."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from mgsr.geometry.triangles import vertex_normals


def umbrella(faces: np.ndarray, vertex_count: int) -> sparse.csr_matrix:
    """The mesh's Laplacian [V,V]: the mean of a vertex's neighbours less the vertex; a row of zeros without any."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = np.concatenate([sides, sides[:, ::-1]])
    ones = np.ones(len(sides), np.float64)
    joined = sparse.coo_matrix((ones, (sides[:, 0], sides[:, 1])), (vertex_count, vertex_count)).tocsr()
    joined.data[:] = 1
    counts = np.asarray(joined.sum(axis=1)).ravel()
    return (sparse.diags(1 / np.maximum(counts, 1)) @ joined - sparse.diags((counts > 0) * 1.0)).tocsr()


def edge_length(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The mean length of the faces' sides."""
    corners = vertices[faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean())


def mean_normals(normals: np.ndarray, laplacian: sparse.csr_matrix, rounds: int) -> np.ndarray:
    """Unit normals [V,3], `rounds` times averaged over the neighbours."""
    for _ in range(rounds):
        normals = normals + laplacian @ normals
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return normals


def smooth_displacements(
    laplacian: sparse.csr_matrix, wanted: np.ndarray, weights: np.ndarray, reach: float
) -> np.ndarray:
    """The displacements x [V] that minimise sum weights (x - wanted)^2 + reach^4 |laplacian x|^2.

    wanted, weights [V]: where each vertex should go and how much that matters, which must be more than nothing.
    reach: over about how many edges a displacement of weight 1 spreads.
    """
    return _solve(laplacian, weights, weights * wanted, reach)


def smooth_vertices(vertices: np.ndarray, faces: np.ndarray, reach: float) -> np.ndarray:
    """The vertices [V,3] moved along their normals until what is finer than about `reach` edges is gone; the coarser
    shape does not shrink (a thin plate). For closed surfaces: a rim would be drawn in."""
    laplacian = umbrella(faces, len(vertices))
    normals = vertex_normals(vertices, faces).astype(np.float64)
    bumps = ((laplacian @ vertices) * normals).sum(1)
    moves = _solve(laplacian, np.ones(len(vertices)), -(reach**4) * (laplacian.T @ bumps), reach)
    return vertices + moves[:, None] * normals


def _solve(laplacian: sparse.csr_matrix, weights: np.ndarray, pull: np.ndarray, reach: float) -> np.ndarray:
    """x [V] with (weights + reach^4 laplacian^T laplacian) x = pull."""
    matrix = (sparse.diags(weights) + reach**4 * (laplacian.T @ laplacian)).tocsr()
    diagonal = matrix.diagonal()
    jacobi = LinearOperator(matrix.shape, matvec=lambda values: values / diagonal)
    return cg(matrix, pull, rtol=1e-4, maxiter=500, M=jacobi)[0]
