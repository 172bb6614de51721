"""Vertices moved to where data wants them, and smoothly in between."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg


def umbrella(faces: np.ndarray, vertex_count: int) -> sparse.csr_matrix:
    """The mesh's Laplacian [V,V]: the mean of a vertex's neighbours less the vertex; a row of zeros without any."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = np.concatenate([sides, sides[:, ::-1]])
    ones = np.ones(len(sides), np.float64)
    joined = sparse.coo_matrix((ones, (sides[:, 0], sides[:, 1])), (vertex_count, vertex_count)).tocsr()
    joined.data[:] = 1
    counts = np.asarray(joined.sum(axis=1)).ravel()
    return (sparse.diags(1 / np.maximum(counts, 1)) @ joined - sparse.diags((counts > 0) * 1.0)).tocsr()


def edges(faces: np.ndarray) -> np.ndarray:
    """The sides [E,2] of the faces [F,3], each once, the lower index first."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
    width = 1 + (int(sides.max()) if len(sides) else 0)
    return np.stack(np.divmod(np.unique(sides[:, 0] * width + sides[:, 1]), width), axis=1)


def edge_length(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The mean length of the faces' sides."""
    corners = vertices[faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean())


def mean_normals(normals: np.ndarray, laplacian: sparse.csr_matrix, rounds: int) -> np.ndarray:
    """Unit normals [V,3], `rounds` times averaged over the neighbours."""
    for _ in range(rounds):
        normals = _unit(normals + laplacian @ normals)
    return normals


def spread(values: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Values [V,...] averaged over the surface around, like a Gaussian of `reach` edges (by diffusion)."""
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
    """The displacements x [V] that minimise sum weights (x - wanted)^2 + reach^4 |laplacian x|^2.

    wanted, weights [V]: where each vertex should go and how much that matters, which must be more than nothing.
    reach: over about how many edges a displacement of weight 1 spreads.
    carry [P,V]: wanted and weights are then of P points, whose displacements are carry @ x (`interpolation`).
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
    """The displacements [V] along the vertex normals [V,3] after which the edges [E,2] have turned as far as these
    normals are to turn to be the wanted ones [V,3].

    They minimise sum hold (x - offsets)^2 + strength * sum over edges (component of the edge along its mean wanted
    normal, less what it had along its mean normal)^2; an edge counts as much as the less sure [V], 0..1, of its ends.
    An edge need not lie across its mean normal, as where a flat face meets a round one: asked for, that alone would
    bend a surface whose normals are right. hold, offsets [V]: what the positions themselves want, and how much, which
    must be more than nothing.
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
    return cg(matrix, right, rtol=1e-4, maxiter=500, M=jacobi)[0]
