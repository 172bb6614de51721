"""A mesh's shallow waves taken off: what training leaves between the places that photographs tell of."""

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
    """The vertices [V,3] moved so that each one's normal comes near the one that those around it lead to.

    unit: a length, such as a pixel's on the surface; waves of a few of it are smoothed. angle: degrees; normals that
    differ by this weigh 0.6, by three times as much next to nothing, so that creases stay.

    `smooth_noise` evens facets to the mean of their neighbours. Over more than neighbours a mean would flatten what is
    round; so a normal is here the one of a linear fit to those around, weighed as in a bilateral filter (Tomasi and
    Manduchi 1998): local regression, as Cleveland (1979) has it. Positions then follow, but for the large shape.
    """
    before, triangles = coarser(vertices, faces, EDGE * unit)
    if len(triangles) == 0:
        return vertices
    normals = vertex_normals(before, triangles).astype(np.float64)
    wanted = _fitted_normals(before / (REACH * unit), triangles, normals, np.deg2rad(angle))
    strength = (KEPT * unit / edge_length(before, triangles)) ** 2
    ones, zeros = np.ones(len(before)), np.zeros(len(before))
    moves = bend_to_normals(before, edges(triangles), normals, wanted, ones, strength, ones, zeros)
    return vertices + interpolation(before, triangles, vertices) @ (moves[:, None] * normals)


def _fitted_normals(places: np.ndarray, faces: np.ndarray, normals: np.ndarray, angle: float) -> np.ndarray:
    """The unit normals [V,3] that linear fits to those around lead to. places [V,3]: in deviations of the weights."""
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
    """The vertices around each, itself among them: parts [CHUNK,V] whose numbers are weights by area and nearness."""
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
    """A vertex' share of its faces' areas, [V]."""
    areas = np.linalg.norm(face_crosses(places, faces), axis=1) / 6
    return np.bincount(faces.ravel(), np.repeat(areas, 3), len(places))


def _moments(places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What is summed up around a vertex: 1, the place, the normal, and the products of the place with both, [V,25]."""
    squares, products = ((places[:, :, None] * each[:, None, :]).reshape(len(places), 9) for each in (places, normals))
    return np.concatenate([np.ones((len(places), 1)), places, normals, squares, products], axis=1)


def _alike(around: sparse.csr_matrix, own: np.ndarray, normals: np.ndarray, angle: float) -> sparse.csr_matrix:
    """A part's weights by the likeness of the normals [V,3] to its own [C,3] too; angle: radians."""
    unlike = 1 - np.einsum("ij,ij->i", np.repeat(own, np.diff(around.indptr), axis=0), normals[around.indices])
    return sparse.csr_matrix((around.data * np.exp(-unlike / angle**2), around.indices, around.indptr), around.shape)


def _fit(around: sparse.csr_matrix, table: np.ndarray, own: np.ndarray, here: np.ndarray) -> np.ndarray:
    """The unit normals [C,3] of fits that are linear along a part's tangent planes, at its places `here` [C,3]; around:
    weights [C,V]; table: `_moments`; own: the normals [C,3] so far."""
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
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-20)
