"""Smoothing of a mesh's low-frequency waves, which training leaves where photographs tell little."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import bend_to_normals, edge_length, edges
from mgsr.geometry.raycast import interpolation
from mgsr.geometry.triangles import face_crosses, vertex_normals

EDGE = 1.0  # units; edges of the mesh that is worked on
REACH = 2.5  # units; deviation of the Gaussian by which a vertex' surroundings weigh
FAR = 2.0  # deviations; what lies beyond counts no more
ROUNDS = 3  # of the normals' filter
CHUNK = 8192  # vertices whose surroundings are looked at at a time
SLOPES = 0.15  # of REACH squared; how firmly the normals' slope is held to 0 where few vertices tell it
KEPT = 2.0  # units; waves of more than 2 pi times this keep their places, shorter ones follow the normals


def smooth_waves(vertices: np.ndarray, faces: np.ndarray, unit: float, angle: float) -> np.ndarray:
    """Return the vertices [V,3] moved so that each normal comes near a local linear fit of those around it.

    unit: a length, such as a pixel's on the surface; waves of a few units are smoothed. angle: degrees; normals that
    differ by this weigh 0.6, and those that differ by three times as much hardly count, so that creases stay.

    `smooth_noise` moves face normals to the mean of their neighbours. Over more neighbours a mean would flatten what is
    round, so each normal is fitted here: local regression (Cleveland 1979) with a bilateral filter's weights (Tomasi
    and Manduchi 1998). The positions then follow, but for the large shape.
    """
    before, triangles = coarser(vertices, faces, EDGE * unit)
    if len(triangles) == 0:
        return vertices
    normals = vertex_normals(before, triangles).astype(np.float64)
    wanted = _fitted_normals(before / (REACH * unit), triangles, normals, np.deg2rad(angle))
    strength = (KEPT * unit / edge_length(before, triangles)) ** 2
    ones, zeros = np.ones(len(before)), np.zeros(len(before))
    moves = bend_to_normals(before, edges(triangles), normals, wanted, ones, strength, ones, zeros)
    moved: np.ndarray = vertices + interpolation(before, triangles, vertices) @ (moves[:, None] * normals)
    return moved


def _fitted_normals(places: np.ndarray, faces: np.ndarray, normals: np.ndarray, angle: float) -> np.ndarray:
    """Fit unit normals [V,3] linearly to those around each vertex, in ROUNDS rounds.

    places [V,3]: positions in units of the weights' deviation; faces [F,3]; normals [V,3]; angle: radians.
    """
    parts = _surroundings(places, _areas(places, faces))
    for _ in range(ROUNDS):
        table = _moments(places, normals)
        owns, heres = (np.array_split(each, range(CHUNK, len(places), CHUNK)) for each in (normals, places))
        normals = np.concatenate(
            [
                _fit(_alike(around, own, normals, angle), table, own, here)
                for around, own, here in zip(parts, owns, heres, strict=True)
            ]
        )
    return normals


def _surroundings(places: np.ndarray, areas: np.ndarray) -> list[sparse.csr_matrix]:
    """Return the weights of the vertices around each vertex, itself among them, by area and nearness.

    places [V,3]: in units of the weights' deviation; areas [V]. The result is a list of sparse matrices, each with
    CHUNK rows (the last with fewer) and V columns.
    """
    count = len(places)
    pairs = cKDTree(places).query_pairs(FAR, output_type="ndarray").astype(np.int32)
    ones = np.ones(len(pairs), np.int8)
    half = sparse.csr_matrix((ones, (pairs[:, 0], pairs[:, 1])), (count, count))
    whole = (half + half.T + sparse.identity(count, np.int8, "csr")).tocsr()
    parts = []
    for start in range(0, count, CHUNK):
        around = whole[start : start + CHUNK].astype(np.float64)
        ways = places[around.indices] - np.repeat(places[start : start + CHUNK], np.diff(around.indptr), axis=0)
        around.data = areas[around.indices] * np.exp(-np.einsum("ij,ij->i", ways, ways) / 2)
        parts.append(around)
    return parts


def _areas(places: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return each vertex's share of its faces' areas, [V]."""
    areas = np.linalg.norm(face_crosses(places, faces), axis=1) / 6
    return np.bincount(faces.ravel(), np.repeat(areas, 3), len(places))


def _moments(places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the moments [V,25] that are summed around a vertex.

    They are 1, the place, the normal, and the outer products of the place with both.
    """
    squares, products = ((places[:, :, None] * each[:, None, :]).reshape(len(places), 9) for each in (places, normals))
    return np.concatenate([np.ones((len(places), 1)), places, normals, squares, products], axis=1)


def _alike(around: sparse.csr_matrix, own: np.ndarray, normals: np.ndarray, angle: float) -> sparse.csr_matrix:
    """Multiply a chunk's weights [C,V] by the likeness of the normals [V,3] to its own [C,3].

    angle: radians; normals that differ by this weigh 0.6.
    """
    unlike = 1 - np.einsum("ij,ij->i", np.repeat(own, np.diff(around.indptr), axis=0), normals[around.indices])
    return sparse.csr_matrix((around.data * np.exp(-unlike / angle**2), around.indices, around.indptr), around.shape)


def _fit(around: sparse.csr_matrix, table: np.ndarray, own: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the unit normals [C,3], at places `here` [C,3], of fits that are linear along the tangent planes.

    around [C,V]: weights; table [V,25]: `_moments`; own [C,3]: the normals before the fit.
    """
    sums = around @ table
    total = np.maximum(sums[:, :1], 1e-20)
    middle, mean = sums[:, 1:4] / total, sums[:, 4:7] / total
    # About the middle of what is around, the fit's two parts are apart: the mean, and the slopes from the covariances.
    spread = sums[:, 7:16].reshape(-1, 3, 3) / total[..., None] - middle[:, :, None] * middle[:, None, :]
    changes = sums[:, 16:].reshape(-1, 3, 3) / total[..., None] - middle[:, :, None] * mean[:, None, :]
    tangents = np.linalg.svd(own[:, None, :])[2][:, 1:]
    flat = tangents @ spread @ tangents.transpose(0, 2, 1) + SLOPES * np.eye(2)
    slopes = np.linalg.solve(flat, tangents @ changes)
    ways = np.einsum("vti,vi->vt", tangents, here - middle)
    values = mean + np.einsum("vt,vti->vi", ways, slopes)
    normals: np.ndarray = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-20)
    return normals
