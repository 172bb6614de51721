"""Smoothing of a mesh's low-frequency waves, which training leaves where photographs tell little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import integrate_normals
from mgsr.geometry.mesh import Mesh

CHUNK = 8192  # vertices whose neighbourhoods are handled at a time


@dataclass(frozen=True)
class LowFrequencyOptions:
    """Numbers of the smoothing of low-frequency waves. A unit is a length that the caller gives, such as a pixel's."""

    edge: float = 1.0  # units; edges of the mesh that is worked on
    reach: float = 2.5  # units; deviation of the Gaussian by which a vertex' neighbourhood weighs
    far: float = 2.0  # deviations; what lies beyond counts no more
    rounds: int = 3  # of the normals' filter
    regularization: float = 0.15  # of reach squared; how firmly a fit's slopes are held to 0 where few vertices tell
    kept: float = 2.0  # units; waves of more than 2 pi times this keep their places, shorter ones follow the normals


def smooth_low_frequency(
    mesh: Mesh, unit: float, angle: float, options: LowFrequencyOptions = LowFrequencyOptions()
) -> Mesh:
    """Return the mesh with its vertices moved so that each normal comes near a local linear fit of those around it.

    unit: a length, such as a pixel's on the surface; waves of a few units are smoothed. angle: degrees; normals that
    differ by this weigh 0.6, and those that differ by three times as much hardly count, so that creases stay.

    `bilateral_normal_filter` moves face normals to the mean of their neighbours. Over more neighbours a mean would
    flatten what is round, so each normal is fitted here: local regression (Cleveland 1979) with a bilateral filter's
    weights (Tomasi and Manduchi 1998). The positions then follow, but for the large shape.
    """
    coarse = coarser(mesh, options.edge * unit)
    if len(coarse.faces) == 0:
        return mesh
    target = _fitted_normals(coarse, unit, np.deg2rad(angle), options)
    strength = (options.kept * unit / coarse.edge_length) ** 2
    ones, zeros = np.ones(len(coarse.vertices)), np.zeros(len(coarse.vertices))
    moves = integrate_normals(coarse, target, ones, strength, ones, zeros)
    return mesh.moved(mesh.vertices + coarse.prolongation(mesh.vertices) @ (moves[:, None] * coarse.double_normals))


def _fitted_normals(mesh: Mesh, unit: float, angle: float, options: LowFrequencyOptions) -> np.ndarray:
    """Fit unit normals [V,3] linearly to those around each vertex, in rounds. angle: radians."""
    scaled = mesh.moved(mesh.vertices / (options.reach * unit))
    places, normals = scaled.vertices, mesh.double_normals
    parts = _neighbourhoods(places, _areas(scaled), options.far)
    for _ in range(options.rounds):
        table = _moments(places, normals)
        owns, heres = (np.array_split(each, range(CHUNK, len(places), CHUNK)) for each in (normals, places))
        normals = np.concatenate(
            [
                _fit(_alike(around, own, normals, angle), table, own, here, options.regularization)
                for around, own, here in zip(parts, owns, heres, strict=True)
            ]
        )
    return normals


def _neighbourhoods(places: np.ndarray, areas: np.ndarray, far: float) -> list[sparse.csr_matrix]:
    """Return the weights of the vertices around each vertex, itself among them, by area and nearness.

    places [V,3]: in units of the weights' deviation; areas [V]; far: in the same units. The result is a list of sparse
    matrices, each with CHUNK rows (the last with fewer) and V columns.
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
    """Return each vertex's share of its faces' areas, [V]."""
    areas = np.linalg.norm(mesh.face_crosses, axis=1) / 6
    return np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices))


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


def _fit(
    around: sparse.csr_matrix, table: np.ndarray, own: np.ndarray, here: np.ndarray, regularization: float
) -> np.ndarray:
    """Return the unit normals [C,3], at places `here` [C,3], of fits that are linear along the tangent planes.

    around [C,V]: weights; table [V,25]: `_moments`; own [C,3]: the normals before the fit; regularization: of its
    slopes.
    """
    sums = around @ table
    total = np.maximum(sums[:, :1], 1e-20)
    middle, mean = sums[:, 1:4] / total, sums[:, 4:7] / total
    # About the middle of what is around, the fit's two parts are apart: the mean, and the slopes from the covariances.
    spread = sums[:, 7:16].reshape(-1, 3, 3) / total[..., None] - middle[:, :, None] * middle[:, None, :]
    changes = sums[:, 16:].reshape(-1, 3, 3) / total[..., None] - middle[:, :, None] * mean[:, None, :]
    tangents = np.linalg.svd(own[:, None, :])[2][:, 1:]
    flat = tangents @ spread @ tangents.transpose(0, 2, 1) + regularization * np.eye(2)
    slopes = np.linalg.solve(flat, tangents @ changes)
    ways = np.einsum("vti,vi->vt", tangents, here - middle)
    values = mean + np.einsum("vt,vti->vi", ways, slopes)
    normals: np.ndarray = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-20)
    return normals
