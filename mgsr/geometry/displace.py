"""Smooth displacements of mesh vertices towards target positions or target normals."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg


def umbrella(faces: np.ndarray, vertex_count: int) -> sparse.csr_matrix:
    """Return the uniform Laplacian [V,V] of a mesh with faces [F,3].

    A row takes the mean of a vertex's neighbours less the vertex itself. The row of a vertex without neighbours is 0.
    """
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = np.concatenate([sides, sides[:, ::-1]])
    ones = np.ones(len(sides), np.float64)
    joined = sparse.coo_matrix((ones, (sides[:, 0], sides[:, 1])), (vertex_count, vertex_count)).tocsr()
    joined.data[:] = 1
    counts = np.asarray(joined.sum(axis=1)).ravel()
    return (sparse.diags(1 / np.maximum(counts, 1)) @ joined - sparse.diags((counts > 0) * 1.0)).tocsr()


def edges(faces: np.ndarray) -> np.ndarray:
    """Return the edges [E,2] of the faces [F,3], each once, the lower vertex index first."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
    width = 1 + (int(sides.max()) if len(sides) else 0)
    return np.stack(np.divmod(np.unique(sides[:, 0] * width + sides[:, 1]), width), axis=1)


def edge_length(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the mean length of the sides of all faces, in the vertices' unit.

    vertices [V,3]; faces [F,3]. A side that two faces share counts twice.
    """
    corners = vertices[faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean())


def mean_normals(normals: np.ndarray, laplacian: sparse.csr_matrix, rounds: int) -> np.ndarray:
    """Average unit normals [V,3] over the neighbouring vertices, `rounds` times, and return unit normals [V,3]."""
    for _ in range(rounds):
        normals = _unit(normals + laplacian @ normals)
    return normals


def spread(values: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Smooth values [V,...] over the surface by diffusion, like a Gaussian with a deviation of `reach` edges."""
    for _ in range(round(4 * reach**2)):  # a step spreads by half an edge along each of the two axes
        values = values + 0.5 * (laplacian @ values)
    return values


def smooth_displacements(
    laplacian: sparse.csr_matrix,
    wanted: np.ndarray,
    weights: np.ndarray,
    reach: float,
    carry: sparse.csr_matrix | None = None,
) -> np.ndarray:
    """Return the displacements x [V] that minimise sum weights (x - wanted)^2 + reach^4 |laplacian x|^2.

    wanted, weights [V]: the target displacement of each vertex, and its weight, which must be positive.
    reach: the number of edges over which a displacement of weight 1 spreads.
    carry [P,V]: if given, wanted and weights belong to P points, whose displacements are carry @ x (`interpolation`).
    """
    carry = sparse.identity(len(wanted), format="csr") if carry is None else carry
    matrix = carry.T @ sparse.diags(weights) @ carry + reach**4 * (laplacian.T @ laplacian)
    return _solve(matrix.tocsr(), carry.T @ (weights * wanted))


def bend_to_normals(
    vertices: np.ndarray,
    edges: np.ndarray,
    normals: np.ndarray,
    wanted: np.ndarray,
    sure: np.ndarray,
    strength: float,
    hold: np.ndarray,
    offsets: np.ndarray,
) -> np.ndarray:
    """Return the displacements [V] along the vertex normals that turn the edges [E,2] towards the target normals.

    The result x minimises sum hold (x - offsets)^2 + strength * sum over edges (component of the moved edge along its
    mean target normal, less the component that it had along its mean present normal)^2. So edges turn by as much as the
    normals are to turn. An edge need not lie across its mean normal, as where a flat face meets a round one; to demand
    that would bend a surface whose normals are right.

    vertices [V,3]; normals, wanted [V,3]: the present and the target unit normals.
    sure [V] in 0..1: the confidence in each target normal; an edge takes the lower one of its two ends.
    offsets, hold [V]: the displacements that the positions ask for, and their weights, which must be positive.
    """
    trust = sure[edges].min(axis=1)
    first, second = edges[trust > 0].T
    across, had = (_unit(each[first] + each[second]) for each in (wanted, normals))
    row = np.arange(len(first))
    shares = np.concatenate([-(normals[first] * across).sum(1), (normals[second] * across).sum(1)])
    places = (np.concatenate([row, row]), np.concatenate([first, second]))
    slopes = sparse.coo_matrix((shares, places), (len(first), len(vertices))).tocsr()
    turn = ((vertices[second] - vertices[first]) * (across - had)).sum(1)
    weighed = slopes.T @ sparse.diags(strength * trust[trust > 0])
    matrix = (sparse.diags(hold) + weighed @ slopes).tocsr()
    return _solve(matrix, hold * offsets - weighed @ turn)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9))


def _solve(matrix: sparse.csr_matrix, right: np.ndarray) -> np.ndarray:
    diagonal = np.maximum(matrix.diagonal(), 1e-12)
    jacobi = LinearOperator(matrix.shape, matvec=lambda values: values / diagonal)
    solution: np.ndarray = cg(matrix, right, rtol=1e-4, maxiter=500, M=jacobi)[0]
    return solution
