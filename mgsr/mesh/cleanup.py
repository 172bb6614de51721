"""Clean-up of a raw surface: pull it into the silhouettes, drop what no camera sees, and orient it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import Triangles, boundary_loops, face_components, keep_faces, vertex_normals
from mgsr.mesh.consistency import Hull
from mgsr.mesh.views import SurfaceView


def pull_into_hull(vertices: np.ndarray, faces: np.ndarray, hull: Hull, margin: float, reach: float) -> Triangles:
    """Move vertices outside a silhouette inwards along their normals, and cut off faces that lie too far outside.

    A face is cut off where a vertex would have to move by more than `reach`, in the scene's unit. margin: pixels
    outside a silhouette that are forgiven.
    """
    excess = hull.excess(vertices, margin)
    outside = np.flatnonzero((excess > 0) & (excess <= reach))
    inwards, moved = -vertex_normals(vertices, faces)[outside], vertices.copy()
    for _ in range(3):
        # At a silhouette the normal lies in the image plane, so the excess there is the distance along the normal.
        moved[outside] += inwards * hull.excess(moved[outside], margin)[:, None]
    return keep_faces(moved, faces, (excess <= reach)[faces].all(1))


def seen_sides(vertices: np.ndarray, faces: np.ndarray, views: Sequence[SurfaceView], gap: float) -> np.ndarray:
    """Return the side from which a view sees each vertex, [V]: 1 the front, -1 the back, 0 none.

    By ray casting. The first view that sees a vertex, at a pixel that its mask does not leave out, decides. What lies
    within `gap` before a vertex does not hide it.
    """
    caster, normals = RayCaster(vertices, faces), vertex_normals(vertices, faces)
    sides, open_ = np.zeros(len(vertices), np.int8), np.arange(len(vertices))
    for view in _spread(views):
        visible = caster.sees(view.camera, vertices[open_], gap, view.mask)
        index = open_[visible]
        front = ((view.camera.center - vertices[index]) * normals[index]).sum(1) >= 0
        sides[index], open_ = np.where(front, 1, -1), open_[~visible]
    return sides


def _spread(views: Sequence[SurfaceView]) -> list[SurfaceView]:
    """Order the views so that each is as far as can be from those before it: the first few see most of the surface."""
    centers = np.array([view.camera.center for view in views])
    order, nearest = [0], np.linalg.norm(centers - centers[0], axis=1)
    nearest[0] = -1
    while len(order) < len(views):
        order.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(centers - centers[order[-1]], axis=1))
        nearest[order] = -1
    return [views[index] for index in order]


def turn_outwards(faces: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return the faces with every piece turned round whose vertices are mostly seen from the back (`seen_sides`)."""
    count, pieces = face_components(faces, len(sides))
    votes = np.bincount(pieces, sides[faces].sum(1), count)
    return np.where((votes < 0)[pieces][:, None], faces[:, ::-1], faces)


def drop_unseen(vertices: np.ndarray, faces: np.ndarray, seen: np.ndarray, whole_pieces: bool) -> Triangles:
    """Return the mesh without what no camera sees (seen [V] bool): floaters' insides, inner shells, invented caps.

    whole_pieces: keep every face of a piece that is seen somewhere, so that closed surfaces stay closed.
    """
    if whole_pieces:
        count, pieces = face_components(faces, len(vertices))
        visible = np.bincount(pieces, seen[faces].any(1), count) > 0
        return keep_faces(vertices, faces, visible[pieces])
    ring = _grown(_grown(seen, faces), faces)
    return keep_faces(vertices, faces, ring[faces].all(1))


def _grown(marked: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the marked vertices [V] and their neighbours: creases hide single vertices of a surface that is seen."""
    grown = marked.copy()
    grown[faces[marked[faces].any(1)]] = True
    return grown


def close_loops(vertices: np.ndarray, faces: np.ndarray) -> Triangles:
    """Return the mesh with every boundary loop closed by a fan of faces around the loop's middle."""
    rim, loops = boundary_loops(faces)
    if len(rim) == 0:
        return vertices, faces
    counts = np.bincount(loops)
    sums = np.stack([np.bincount(loops, vertices[rim[:, 0], axis]) for axis in range(3)], axis=1)
    fan = np.column_stack([rim[:, 1], rim[:, 0], len(vertices) + loops])
    return np.concatenate([vertices, sums / counts[:, None]]), np.concatenate([faces, fan])
