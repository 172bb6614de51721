"""A mesh's noise smoothed away, its creases kept."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from mgsr.geometry.displace import edge_length
from mgsr.geometry.triangles import face_crosses

ROUNDS = 4  # of the normals' filter: more flattens what was photographed
STEPS = 10  # in which the vertices follow the normals
FOLDED = 0.7  # cosine to its filtered normal under which a facet counts as folded
CHUNK = 65_536  # facets whose surroundings are held in memory at a time


def smooth_noise(vertices: np.ndarray, faces: np.ndarray, angle: float) -> np.ndarray:
    """The vertices [V,3] moved so that each facet's normal comes near the mean of those around it.

    angle: degrees; normals that differ by this weigh 0.6 in that mean, by three times as much next to nothing, so that
    creases stay. A facet's surroundings are those that share a vertex with it.

    Sources: Zheng, Fu, Au and Tai, Bilateral Normal Filtering for Mesh Denoising (2011), the filter; Sun, Rosin,
    Martin and Langbein, Fast and Effective Feature-Preserving Mesh Denoising (2007), how vertices follow.
    """
    if len(faces) == 0:
        return vertices
    corners = np.repeat(np.arange(len(faces)), 3)
    touches = sparse.csr_matrix(
        (np.ones(faces.size, np.float32), (corners, faces.ravel())), (len(faces), len(vertices))
    )
    given = _facet_normals(vertices, faces)
    areas = np.linalg.norm(face_crosses(vertices, faces), axis=1).astype(np.float32)
    middles = vertices[faces].mean(axis=1).astype(np.float32)
    reach, normals = edge_length(vertices, faces), given.astype(np.float32)
    for _ in range(ROUNDS):
        normals = _mean_normals(touches, normals, middles, areas, reach, np.deg2rad(angle))
    moved = _follow(vertices, faces, touches, normals.astype(np.float64))
    return _unfold(moved, vertices, faces, normals, (given * normals).sum(1))


def _facet_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    crosses = face_crosses(vertices, faces)
    return crosses / np.maximum(np.linalg.norm(crosses, axis=1), 1e-20)[:, None]


def _mean_normals(
    touches: sparse.csr_matrix,
    normals: np.ndarray,
    middles: np.ndarray,
    areas: np.ndarray,
    reach: float,
    angle: float,
) -> np.ndarray:
    """Each facet's normal [F,3] as the mean over its surroundings, by area, nearness and likeness; angle: radians."""
    parts = []
    for start in range(0, len(normals), CHUNK):
        around = (touches[start : start + CHUNK] @ touches.T).tocoo()
        here, there = around.row + start, around.col
        apart = ((middles[here] - middles[there]) ** 2).sum(1) / reach**2
        unlike = (2 - 2 * (normals[here] * normals[there]).sum(1)) / angle**2
        weights = areas[there] * np.exp(-(apart + unlike) / 2)
        sums = sparse.csr_matrix((weights, (around.row, there)), around.shape) @ normals
        parts.append(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-20))
    return np.concatenate(parts)


def _follow(vertices: np.ndarray, faces: np.ndarray, touches: sparse.csr_matrix, normals: np.ndarray) -> np.ndarray:
    """The vertices [V,3], stepwise moved to the planes through their facets' middles across the normals [F,3]."""
    counts = np.maximum(np.bincount(faces.ravel(), minlength=len(vertices)), 1)
    mean = (sparse.diags(1.0 / counts) @ touches.T).tocsr()  # over the facets around a vertex
    projections = (mean @ (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
    for _ in range(STEPS):
        heights = (normals * vertices[faces].mean(axis=1)).sum(1)
        vertices = vertices + mean @ (normals * heights[:, None]) - np.einsum("vij,vj->vi", projections, vertices)
    return vertices


def _unfold(
    moved: np.ndarray, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, given: np.ndarray
) -> np.ndarray:
    """The moved vertices, but back in their places where a facet came to stand across its normal; slivers do.

    given: cosines [F] between the facets as they were and their normals [F,3]; what was no better then stays moved.
    """
    while True:
        likeness = (_facet_normals(moved, faces) * normals).sum(1)
        folded = (likeness < FOLDED) & (likeness < given)
        if not folded.any():
            return moved
        back = faces[folded]
        moved[back] = vertices[back]
