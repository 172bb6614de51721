"""Smoothing of the low-frequency waves that training leaves on a mesh where photographs constrain it weakly."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from mgsr.config.expert import LowFrequencyOptions
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import integrate_normals
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead

CHUNK = 8192  # vertices whose neighbourhoods are handled at a time


def smooth_low_frequency(
    mesh: Mesh, unit: float, angle: float, options: LowFrequencyOptions = LowFrequencyOptions()
) -> Mesh:
    """Smooth waves of a few units: fit the normals locally, and move the vertices to match them.

    unit: a length in the vertices' unit, such as a pixel's size on the surface. angle: degrees. A neighbour whose
    normal differs by `angle` weighs 0.6, and one that differs by three times as much hardly counts, so creases stay.

    `bilateral_normal_filter` replaces a normal by the mean of its neighbours. Over larger neighbourhoods, a mean
    flattens round surfaces. So each normal is a linear fit here: local regression (Cleveland 1979) with the weights of
    a bilateral filter (Tomasi and Manduchi 1998). The vertices follow the normals, and the large shape stays.
    """
    coarse = coarser(mesh, options.edge * unit, options.max_faces)
    if len(coarse.faces) == 0:
        return mesh
    target = _fitted_normals(coarse, unit, np.deg2rad(angle), options)
    strength = (options.kept * unit / coarse.edge_length) ** 2
    ones, zeros = np.ones(len(coarse.vertices)), np.zeros(len(coarse.vertices))
    moves = integrate_normals(coarse, target, ones, strength, ones, zeros)
    return mesh.moved(mesh.vertices + coarse.prolongation(mesh.vertices) @ (moves[:, None] * coarse.double_normals))


def _fitted_normals(mesh: Mesh, unit: float, angle: float, options: LowFrequencyOptions) -> np.ndarray:
    """Return unit normals [V,3], each a linear fit to those around its vertex, in several rounds.

    unit: in the vertices' unit. angle: radians.
    """
    scaled = mesh.moved(mesh.vertices / (options.reach * unit))
    places, normals = scaled.vertices, mesh.double_normals
    parts = _neighbourhoods(places, _areas(scaled), options.far)

    def fitted(chunk: tuple[sparse.csr_matrix, np.ndarray, np.ndarray]) -> np.ndarray:
        around, own, here = chunk
        return _fit(_alike(around, own, normals, angle), table, own, here, options.regularization)

    for _ in range(options.rounds):
        table = _moments(places, normals)
        owns, heres = (np.array_split(each, range(CHUNK, len(places), CHUNK)) for each in (normals, places))
        normals = np.concatenate(list(map_ahead(fitted, zip(parts, owns, heres, strict=True), None)))
    return normals


def _neighbourhoods(places: np.ndarray, areas: np.ndarray, far: float) -> list[sparse.csr_matrix]:
    """Weigh each vertex's neighbours, and the vertex itself, by area and by a Gaussian of distance.

    places [V,3]: positions in units of the Gaussian's deviation. areas [V]. far: the largest distance of a neighbour,
    in the same unit. Returns sparse matrices of CHUNK rows (the last has fewer) and V columns.
    """
    count = len(places)
    pairs = cKDTree(places).query_pairs(far, output_type="ndarray").astype(np.int32)
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


def _areas(mesh: Mesh) -> np.ndarray:
    """Return a third of the area of each vertex's faces, [V]."""
    areas = np.linalg.norm(mesh.face_crosses, axis=1) / 6
    return np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices))


def _moments(places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the moments [V,25] of the positions [V,3] and normals [V,3], which are summed around each vertex.

    They are 1, the position, the normal, and the outer products of the position with itself and with the normal.
    """
    squares, products = ((places[:, :, None] * each[:, None, :]).reshape(len(places), 9) for each in (places, normals))
    return np.concatenate([np.ones((len(places), 1)), places, normals, squares, products], axis=1)


def _alike(around: sparse.csr_matrix, own: np.ndarray, normals: np.ndarray, angle: float) -> sparse.csr_matrix:
    """Multiply a chunk's weights [C,V] by the similarity of the normals [V,3] to its own normals [C,3].

    angle: radians; normals that differ by this weigh 0.6.
    """
    unlike = 1 - np.einsum("ij,ij->i", np.repeat(own, np.diff(around.indptr), axis=0), normals[around.indices])
    return sparse.csr_matrix((around.data * np.exp(-unlike / angle**2), around.indices, around.indptr), around.shape)


def _fit(
    around: sparse.csr_matrix, table: np.ndarray, own: np.ndarray, here: np.ndarray, regularization: float
) -> np.ndarray:
    """Fit normals that vary linearly along the tangent planes, and return their values [C,3], unit, at `here` [C,3].

    around [C,V]: weights. table [V,25]: `_moments`. own [C,3]: the normals before the fit. regularization: of the
    slopes.
    """
    sums = around @ table
    total = np.maximum(sums[:, :1], 1e-20)
    middle, mean = sums[:, 1:4] / total, sums[:, 4:7] / total
    # About the weighted centroid, the fit's two parts decouple: the mean, and the slopes from the covariances.
    spread = sums[:, 7:16].reshape(-1, 3, 3) / total[..., None] - middle[:, :, None] * middle[:, None, :]
    changes = sums[:, 16:].reshape(-1, 3, 3) / total[..., None] - middle[:, :, None] * mean[:, None, :]
    tangents = np.linalg.svd(own[:, None, :])[2][:, 1:]
    flat = tangents @ spread @ tangents.transpose(0, 2, 1) + regularization * np.eye(2)
    slopes = np.linalg.solve(flat, tangents @ changes)
    ways = np.einsum("vti,vi->vt", tangents, here - middle)
    values = mean + np.einsum("vt,vti->vi", ways, slopes)
    normals: np.ndarray = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-20)
    return normals
