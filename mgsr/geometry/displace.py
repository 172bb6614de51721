"""Smooth displacements of mesh vertices towards target positions or target normals."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import unit_vectors

TOLERANCE, MOST_STEPS = 1e-4, 500  # of the conjugate gradients: relative residual at which they end, and most steps


def mean_normals(normals: np.ndarray, laplacian: sparse.csr_matrix, rounds: int) -> np.ndarray:
    """Average unit normals [V,3] with those of neighbouring vertices, `rounds` times; return unit normals [V,3]."""
    for _ in range(rounds):
        normals = unit_vectors(normals + laplacian @ normals)
    return normals


def diffuse(values: np.ndarray, laplacian: sparse.csr_matrix, reach: float) -> np.ndarray:
    """Smooth values [V,...] over the surface by diffusion.

    The result is about that of a Gaussian with a standard deviation of `reach` edges. It has the values' precision.
    """
    smoothed, halved = values.reshape(len(values), -1), (0.5 * laplacian).astype(np.result_type(values, np.float32))
    for _ in range(round(4 * reach**2)):  # a step adds a deviation of half an edge along each of the two axes
        smoothed = smoothed + halved @ smoothed
    return smoothed.reshape(values.shape)


def smooth_displacements(
    laplacian: sparse.csr_matrix,
    target: np.ndarray,
    weights: np.ndarray,
    reach: float,
    prolongation: sparse.csr_matrix | None = None,
) -> np.ndarray:
    """Return the displacements x [V] that minimise sum weights (x - target)^2 + reach^4 |laplacian x|^2.

    target, weights [V]: each vertex's target displacement, and its weight, which must be positive. reach: the number of
    edges over which a displacement of weight 1 spreads. prolongation [P,V]: if given, target and weights are [P] and
    belong to P points with the displacements prolongation @ x (`Mesh.prolongation`).
    """
    prolongation = sparse.identity(len(target), format="csr") if prolongation is None else prolongation
    matrix = prolongation.T @ sparse.diags(weights) @ prolongation + reach**4 * (laplacian.T @ laplacian)
    return _solve(matrix.tocsr(), prolongation.T @ (weights * target))


def integrate_normals(
    mesh: Mesh,
    target: np.ndarray,
    confidence: np.ndarray,
    strength: float,
    prior_weight: np.ndarray,
    prior: np.ndarray,
) -> np.ndarray:
    """Return the displacements [V] along a mesh's normals that turn its edges towards target normals (Nehab 2005).

    The result x minimises the sum over the vertices of prior_weight (x - prior)^2, plus strength times the sum over the
    edges of confidence (t - c)^2. Here t is the component of the moved edge along its mean target normal. c is the
    component of the original edge along its mean current normal. So edges turn by the same angle as the normals. With
    t = 0 as the aim, surfaces with correct normals would bend, because an edge between a flat and a round part is not
    perpendicular to its mean normal.

    target [V,3]: the target unit normals. confidence [V] in 0..1: of the target normals; an edge takes the lower
    confidence of its two ends. prior [V]: the prior displacements, in the vertices' unit. prior_weight [V]: their
    weights, which must be positive.
    """
    vertices, normals, edges = mesh.vertices, mesh.double_normals, mesh.edges
    edge_confidence = confidence[edges].min(axis=1)
    first, second = edges[edge_confidence > 0].T
    across, had = (unit_vectors(each[first] + each[second]) for each in (target, normals))
    row = np.arange(len(first))
    shares = np.concatenate([-(normals[first] * across).sum(1), (normals[second] * across).sum(1)])
    places = (np.concatenate([row, row]), np.concatenate([first, second]))
    slopes = sparse.coo_matrix((shares, places), (len(first), len(vertices))).tocsr()
    turn = ((vertices[second] - vertices[first]) * (across - had)).sum(1)
    weighed = slopes.T @ sparse.diags(strength * edge_confidence[edge_confidence > 0])
    matrix = (sparse.diags(prior_weight) + weighed @ slopes).tocsr()
    return _solve(matrix, prior_weight * prior - weighed @ turn)


def _solve(matrix: sparse.csr_matrix, right: np.ndarray) -> np.ndarray:
    """Solve a symmetric positive definite system [V,V] for a right side [V], by conjugate gradients."""
    diagonal = np.maximum(matrix.diagonal(), 1e-12)
    jacobi = LinearOperator(matrix.shape, matvec=lambda values: values / diagonal)
    solution: np.ndarray = cg(matrix, right, rtol=TOLERANCE, maxiter=MOST_STEPS, M=jacobi)[0]
    return solution
