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
    creases stay. A facet's surroundings are those that share a vertex with it. Vertices that would fold a facet stay.

    Sources: Zheng, Fu, Au and Tai, Bilateral Normal Filtering for Mesh Denoising (2011), the filter; Sun, Rosin,
    Martin and Langbein, Fast and Effective Feature-Preserving Mesh Denoising (2007), how vertices follow.
    """
    if len(faces) == 0:
        return vertices
    vertices = vertices.astype(np.float64)
    corners = np.repeat(np.arange(len(faces)), 3)
    touches = sparse.csr_matrix(
        (np.ones(faces.size, np.float32), (corners, faces.ravel())), (len(faces), len(vertices))
    )
    areas, given = _areas_and_normals(vertices, faces)
    surroundings = _surroundings(touches, vertices[faces].mean(axis=1), areas, edge_length(vertices, faces))
    normals = given.astype(np.float32)
    for _ in range(ROUNDS):
        own = np.array_split(normals, range(CHUNK, len(faces), CHUNK))
        normals = np.concatenate(
            [
                _mean_normals(around, part, normals, np.deg2rad(angle))
                for around, part in zip(surroundings, own, strict=True)
            ]
        )
    moved = _follow(vertices, touches, normals.astype(np.float64))
    return _unfold(moved, vertices, faces, normals, (given * normals).sum(1))


def _areas_and_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twice the areas [F], and the unit normals [F,3]; 0 for a facet without area."""
    crosses = face_crosses(vertices, faces)
    areas = np.linalg.norm(crosses, axis=1)
    return areas, crosses / np.maximum(areas, 1e-20)[:, None]


def _surroundings(
    touches: sparse.csr_matrix, middles: np.ndarray, areas: np.ndarray, reach: float
) -> list[sparse.csr_matrix]:
    """The facets around each, itself among them: parts [CHUNK,F] whose numbers are weights by area and nearness."""
    parts = []
    for start in range(0, len(middles), CHUNK):
        around = touches[start : start + CHUNK] @ touches.T
        here = start + np.repeat(np.arange(around.shape[0]), np.diff(around.indptr))
        ways = middles[around.indices] - middles[here]
        nearness = np.exp(-np.einsum("ij,ij->i", ways, ways) / (2 * reach**2))
        around.data = (areas[around.indices] * nearness).astype(np.float32)
        parts.append(around)
    return parts


def _mean_normals(around: sparse.csr_matrix, own: np.ndarray, normals: np.ndarray, angle: float) -> np.ndarray:
    """A part's normals [C,3] as the means over its surroundings, which weigh by their likeness too; angle: radians."""
    sizes = np.diff(around.indptr)
    unlike = 1 - np.einsum("ij,ij->i", np.repeat(own, sizes, axis=0), normals[around.indices])
    weights = around.data * np.exp(-unlike / angle**2)
    sums = sparse.csr_matrix((weights, around.indices, around.indptr), around.shape) @ normals
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-20)


def _follow(vertices: np.ndarray, touches: sparse.csr_matrix, normals: np.ndarray) -> np.ndarray:
    """The vertices [V,3], stepwise moved to the planes through their facets' middles across the normals [F,3]."""
    counts = np.maximum(touches.getnnz(axis=0), 1)
    mean = (sparse.diags(1.0 / counts) @ touches.T).tocsr()  # over the facets around a vertex
    projections = (mean @ (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
    for _ in range(STEPS):
        heights = np.einsum("fi,fi->f", normals, touches @ vertices) / 3
        vertices = vertices + mean @ (normals * heights[:, None]) - np.einsum("vij,vj->vi", projections, vertices)
    return vertices


def _unfold(
    moved: np.ndarray, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, given: np.ndarray
) -> np.ndarray:
    """The moved vertices, but back in their places where a facet came to stand across its normal; slivers do.

    given: cosines [F] between the facets as they were and their normals [F,3]; what was no better then stays moved.
    """
    while True:
        likeness = (_areas_and_normals(moved, faces)[1] * normals).sum(1)
        folded = (likeness < FOLDED) & (likeness < given)
        if not folded.any():
            return moved
        back = faces[folded]
        moved[back] = vertices[back]
