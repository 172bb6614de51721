"""Bilateral filtering of face normals: mesh denoising that keeps creases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from mgsr.config.expert import BilateralOptions
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead

CHUNK = 16_384  # faces at a time, so that the values of their neighbourhoods stay in the cache


def bilateral_normal_filter(mesh: Mesh, angle: float, options: BilateralOptions = BilateralOptions()) -> Mesh:
    """Denoise a mesh: filter its face normals bilaterally, and move its vertices to match them.

    angle: degrees. A neighbour whose normal differs by `angle` weighs 0.6 in the mean, and one that differs by three
    times as much hardly counts, so creases stay. A face's neighbours are the faces that share a vertex with it.
    Vertices whose move would fold a face stay in place.

    Source of the filter: Zheng, Fu, Au and Tai, Bilateral Normal Filtering for Mesh Denoising (2011). Source of the
    vertex update: Sun, Rosin, Martin and Langbein, Fast and Effective Feature-Preserving Mesh Denoising (2007).
    """
    faces = mesh.faces
    if len(faces) == 0:
        return mesh
    mesh = mesh.moved(mesh.vertices.astype(np.float64))
    corners = np.repeat(np.arange(len(faces)), 3)
    touches = sparse.csr_matrix(
        (np.ones(faces.size, np.float32), (corners, faces.ravel())), (len(faces), len(mesh.vertices))
    )
    areas, given = _areas_and_normals(mesh)
    neighbourhoods = _neighbourhoods(touches, mesh.vertices[faces].mean(axis=1), areas, mesh.edge_length)
    normals = given.astype(np.float32)
    for _ in range(options.rounds):
        normals = _mean_normals(neighbourhoods, normals, np.deg2rad(angle))
    moved = _follow(mesh.vertices, touches, normals.astype(np.float64), options.steps)
    return mesh.moved(_unfold(moved, mesh, normals, (given * normals).sum(1), options.folded))


def _areas_and_normals(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return twice the face areas [F] and the unit face normals [F,3]; the normal of a face without area is 0."""
    areas = np.linalg.norm(mesh.face_crosses, axis=1)
    return areas, mesh.face_crosses / np.maximum(areas, 1e-20)[:, None]


def _neighbourhoods(
    touches: sparse.csr_matrix, middles: np.ndarray, areas: np.ndarray, reach: float
) -> list[sparse.csr_matrix]:
    """Weigh each face's neighbours, and the face itself, by area and by a Gaussian of distance.

    touches [F,V]: 1 where a face has a vertex. middles [F,3]: the faces' centroids. areas [F]. reach: the Gaussian's
    standard deviation, in the vertices' unit. Returns sparse matrices of CHUNK rows (the last has fewer) and F columns.
    """

    def weighed(start: int) -> sparse.csr_matrix:
        around = touches[start : start + CHUNK] @ touches.T
        here = start + np.repeat(np.arange(around.shape[0]), np.diff(around.indptr))
        ways = middles[around.indices] - middles[here]
        nearness = np.exp(-np.einsum("ij,ij->i", ways, ways) / (2 * reach**2))
        around.data = (areas[around.indices] * nearness).astype(np.float32)
        return around

    return list(map_ahead(weighed, range(0, len(middles), CHUNK), None))


def _mean_normals(neighbourhoods: Sequence[sparse.csr_matrix], normals: np.ndarray, angle: float) -> np.ndarray:
    """Return the bilateral mean normals [F,3], unit, of F faces.

    neighbourhoods: from `_neighbourhoods`. normals [F,3]: unit. angle: radians.
    """

    def mean(chunk: int) -> np.ndarray:
        around = neighbourhoods[chunk]
        own = np.repeat(normals[chunk * CHUNK : (chunk + 1) * CHUNK], np.diff(around.indptr), axis=0)
        weights = around.data * np.exp((np.einsum("ij,ij->i", own, normals[around.indices]) - 1) / angle**2)
        sums = sparse.csr_matrix((weights, around.indices, around.indptr), around.shape) @ normals
        return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-20))

    return np.concatenate(list(map_ahead(mean, range(len(neighbourhoods)), None)))


def _follow(vertices: np.ndarray, touches: sparse.csr_matrix, normals: np.ndarray, steps: int) -> np.ndarray:
    """Move the vertices [V,3] so that the faces become perpendicular to the normals [F,3]; return the vertices [V,3].

    Each step moves a vertex towards the planes through its faces' centroids. touches [F,V]: 1 where a face has a
    vertex.
    """
    counts = np.maximum(touches.getnnz(axis=0), 1)
    mean = (sparse.diags(1.0 / counts) @ touches.T).tocsr()  # over the faces around a vertex
    projections = (mean @ (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
    for _ in range(steps):
        heights = np.einsum("fi,fi->f", normals, touches @ vertices) / 3
        vertices = vertices + mean @ (normals * heights[:, None]) - np.einsum("vij,vj->vi", projections, vertices)
    return vertices


def _unfold(moved: np.ndarray, mesh: Mesh, normals: np.ndarray, given: np.ndarray, least: float) -> np.ndarray:
    """Move the vertices of folded faces back: those whose normals are far from the filtered ones.

    moved [V,3]: the vertices after the move; changed in place and returned. mesh: the mesh before the move.
    normals [F,3]: the filtered normals. given [F]: the cosines between `normals` and the face normals before the move;
    a face that was no better before the move stays moved. least: the cosine below which a face counts as folded.
    """
    while True:
        likeness = (_areas_and_normals(Mesh(moved, mesh.faces))[1] * normals).sum(1)
        folded = (likeness < least) & (likeness < given)
        if not folded.any():
            return moved
        back = mesh.faces[folded]
        moved[back] = mesh.vertices[back]
