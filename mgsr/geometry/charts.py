"""Flat charts of a surface: connected parts that face one direction, projected along it.

xatlas cuts noisy surfaces into thousands of charts, and takes as long as a whole run. Here each face joins the nearest
of six directions, and each connected part is projected orthographically.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mgsr.config.expert import ChartOptions
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import tangents

CELL = 2.5  # distance of charts that are laid out beside each other, in the surface's extents


@dataclass(frozen=True)
class Charts:
    """A surface cut into flat charts.

    origin [W]: the surface's vertex of each vertex, which is repeated for each of its charts. faces [F,3]: of these
    vertices, in the surface's order. places [W,2]: float64 in the surface's unit, x right and y down as seen from
    outside; no two charts meet. count: of charts.
    """

    origin: np.ndarray
    faces: np.ndarray
    places: np.ndarray
    count: int


def cut_charts(mesh: Mesh, least: float, options: ChartOptions = ChartOptions()) -> Charts:
    """Cut a surface into charts, each an orthographic projection of faces that lean away by less than 90 degrees.

    least: the area of the smallest chart, in the square of the surface's unit. Smaller parts stay with a neighbour,
    even where that tilts or covers them.
    """
    normals = _face_normals(mesh)
    areas = np.linalg.norm(mesh.face_crosses, axis=1) / 2
    pairs = _neighbours(mesh)
    parts = _joined_small(_by_direction(normals, pairs, options), normals, areas, pairs, least, options)
    for _ in range(options.rounds):
        wrong = _misplaced(mesh, parts, normals, areas, options)
        split = _connected(7 * parts + np.where(wrong, 1 + _nearest_axis(normals), 0), pairs)
        wrong &= (np.bincount(split, areas) >= least)[split]
        if not wrong.any():
            break
        _, parts = np.unique(np.where(wrong, split + len(mesh.faces), parts), return_inverse=True)
    return _laid_out(mesh, parts, normals, areas)


def _face_normals(mesh: Mesh) -> np.ndarray:
    """Return the unit face normals [F,3], 0 without area."""
    crosses = mesh.face_crosses
    return np.asarray(crosses / np.maximum(np.linalg.norm(crosses, axis=1, keepdims=True), 1e-30))


def _neighbours(mesh: Mesh) -> np.ndarray:
    """Return the pairs [E,2] of faces that share an edge; of more than two, neighbours in their order."""
    faces = mesh.faces
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owners = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((owners, sides[:, 1], sides[:, 0]))
    same = (sides[order[1:]] == sides[order[:-1]]).all(axis=1)
    return np.stack([owners[order[:-1]][same], owners[order[1:]][same]], axis=1)


def _by_direction(normals: np.ndarray, pairs: np.ndarray, options: ChartOptions) -> np.ndarray:
    """Return the connected parts [F] of the faces that are nearest to one of six directions.

    Averaging over neighbours decides for faces between two directions, unless it leads too far from a face's own.
    """
    count, ends = len(normals), np.concatenate([pairs, pairs[:, ::-1]])
    near = sparse.coo_matrix((np.ones(len(ends)), ends.T), (count, count)).tocsr() + sparse.eye(count)
    mean = sparse.diags(1 / np.asarray(near.sum(axis=1)).ravel()) @ near
    smooth = normals
    for _ in range(options.smoothing):
        smooth = mean @ smooth
    labels = _nearest_axis(smooth)
    off = np.take_along_axis(_six(normals), labels[:, None], axis=1)[:, 0] < options.min_cosine
    labels[off] = _nearest_axis(normals[off])
    return _connected(labels, pairs)


def _six(directions: np.ndarray) -> np.ndarray:
    """Return the cosines [P,6] of directions [P,3] with +x, +y, +z, -x, -y and -z."""
    return np.concatenate([directions, -directions], axis=1)


def _nearest_axis(directions: np.ndarray) -> np.ndarray:
    """Return the nearest of the six directions to each direction [P,3]."""
    return np.asarray(_six(directions).argmax(axis=1))


def _connected(labels: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return the connected part [F] of each face among the faces with its label [F]."""
    same = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    graph = sparse.coo_matrix((np.ones(len(same), bool), same.T), (len(labels),) * 2)
    parts: np.ndarray = connected_components(graph, directed=False)[1].astype(np.int64)
    return parts


def _joined_small(
    parts: np.ndarray,
    normals: np.ndarray,
    areas: np.ndarray,
    pairs: np.ndarray,
    least: float,
    options: ChartOptions,
) -> np.ndarray:
    """Join parts [F] of little area to the larger neighbour with the longest common border.

    Those above `least` only join a neighbour that faces their way.
    """
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    for _ in range(options.rounds):
        size, axes = np.bincount(parts, areas), _axes(parts, normals, areas)
        borders, lengths = np.unique(parts[ends], axis=0, return_counts=True)
        small, other = borders.T
        cosines = (axes[small] * axes[other]).sum(axis=1)
        alike = (size[small] < options.small * areas.sum()) & (cosines > options.min_cosine)
        join = (small != other) & (size[small] < size[other]) & (alike | (size[small] < least))
        if not join.any():
            break
        order = np.argsort(lengths[join], kind="stable")
        target = np.arange(len(size))
        target[small[join][order]] = other[join][order]
        _, parts = np.unique(target[parts], return_inverse=True)
    return parts


def _misplaced(
    mesh: Mesh, parts: np.ndarray, normals: np.ndarray, areas: np.ndarray, options: ChartOptions
) -> np.ndarray:
    """Return which faces [F] bool their chart tilts too far, or covers by other faces of its own."""
    axes = _axes(parts, normals, areas)
    tilted = (normals * axes[parts]).sum(axis=1) < options.kept * options.min_cosine
    charts = _laid_out(mesh, parts, normals, areas)
    heights = (mesh.vertices[mesh.faces] * axes[parts][:, None]).sum(axis=-1)
    corners = np.concatenate([charts.places[charts.faces], heights[..., None]], axis=-1)
    caster = RayCaster(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    middle = corners.mean(axis=1, keepdims=True)
    samples = np.concatenate([middle, middle + options.inset * (corners - middle)], axis=1)
    gap = 1e-4 * float(np.ptp(mesh.vertices, axis=0).max())
    up = np.broadcast_to(np.array([0.0, 0, 1]), samples.shape)
    hits = caster.cast_rays(samples + gap * up, up)
    own = hits.face == np.arange(len(corners))[:, None]
    return np.asarray(tilted | (hits.mask & ~own).any(axis=1))


def _axes(parts: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Return the mean direction [C,3] of each part's faces; z where there is none."""
    sums = np.stack([np.bincount(parts, normals[:, axis] * areas) for axis in range(3)], axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(lengths > 0, sums / np.maximum(lengths, 1e-30), [[0.0, 0, 1]])


def _laid_out(mesh: Mesh, parts: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> Charts:
    """Project the parts [F] along their mean directions, y down, and lay them out on a square grid."""
    keys = parts[:, None] * len(mesh.vertices) + mesh.faces
    used, faces = np.unique(keys, return_inverse=True)
    part, origin = np.divmod(used, len(mesh.vertices))
    axes = _axes(parts, normals, areas)
    across, along = tangents(axes)
    about = mesh.vertices[origin] - (mesh.vertices.max(axis=0) + mesh.vertices.min(axis=0)) / 2
    places = np.stack([(about * across[part]).sum(axis=1), -(about * along[part]).sum(axis=1)], axis=1)
    columns = int(np.ceil(np.sqrt(len(axes))))
    cell = CELL * float(np.ptp(mesh.vertices, axis=0).max())
    places += cell * np.stack([part % columns, part // columns], axis=1)
    return Charts(origin, faces.reshape(-1, 3), places, len(axes))
