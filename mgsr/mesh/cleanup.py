"""Clean-up of a raw surface: pulling it into the silhouettes, dropping unseen parts, and orienting it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import boundary_loops
from mgsr.geometry.vectors import dots
from mgsr.mesh.consistency import SilhouetteHull
from mgsr.mesh.views import SurfaceView


def pulled_inside(
    positions: np.ndarray, normals: np.ndarray, hull: SilhouetteHull, margin: float, rounds: int = 3
) -> np.ndarray:
    """Move positions [P,3] inwards along unit normals [P,3] until they lie inside the silhouettes; return them.

    margin: the tolerance outside a silhouette, in pixels.
    """
    moved = positions.copy()
    for _ in range(rounds):
        # At a silhouette the normal lies in the image plane, so the excess there is the distance along the normal.
        moved -= normals * hull.excess(moved, margin)[:, None]
    return moved


def pull_into_hull(mesh: Mesh, hull: SilhouetteHull, margin: float, reach: float, rounds: int = 3) -> Mesh:
    """Move vertices outside the silhouettes inwards along their normals, and drop faces that lie too far outside.

    margin: the tolerance outside a silhouette, in pixels. reach: the largest move of a vertex, in the scene's unit;
    faces with a vertex farther outside are dropped.
    """
    excess = hull.excess(mesh.vertices, margin)
    outside = np.flatnonzero((excess > 0) & (excess <= reach))
    moved = mesh.vertices.copy()
    moved[outside] = pulled_inside(moved[outside], mesh.normals[outside], hull, margin, rounds)
    return mesh.moved(moved).keep_faces((excess <= reach)[mesh.faces].all(1))


def seen_sides(mesh: Mesh, views: Sequence[SurfaceView], gap: float) -> np.ndarray:
    """Return the side [V] from which a view sees each vertex: 1 for the front, -1 for the back, 0 for unseen.

    Visibility comes from ray casting. The first view that sees a vertex at a pixel inside its mask decides. gap: the
    distance before a vertex, in the scene's unit, within which nothing occludes it.
    """
    vertices, normals, caster = mesh.vertices, mesh.normals, mesh.caster
    sides, open_ = np.zeros(len(vertices), np.int8), np.arange(len(vertices))
    for view in _farthest_first(views):
        visible = caster.sees(view.camera, vertices[open_], gap, view.mask)
        index = open_[visible]
        front = dots(view.camera.center - vertices[index], normals[index]) >= 0
        sides[index], open_ = np.where(front, 1, -1), open_[~visible]
    return sides


def _farthest_first(views: Sequence[SurfaceView]) -> list[SurfaceView]:
    """Order the views by farthest-point sampling of their centres, so that the first few see most of the surface."""
    centers = np.array([view.camera.center for view in views])
    order, nearest = [0], np.linalg.norm(centers - centers[0], axis=1)
    nearest[0] = -1
    while len(order) < len(views):
        order.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(centers - centers[order[-1]], axis=1))
        nearest[order] = -1
    return [views[index] for index in order]


def turn_outwards(mesh: Mesh, sides: np.ndarray) -> Mesh:
    """Flip the pieces whose vertices are mostly seen from the back.

    sides [V]: the result of `seen_sides`.
    """
    count, pieces = mesh.components
    votes = np.bincount(pieces, sides[mesh.faces].sum(1), count)
    return replace(mesh, faces=np.where((votes < 0)[pieces][:, None], mesh.faces[:, ::-1], mesh.faces))


def drop_unseen(mesh: Mesh, seen: np.ndarray, whole_pieces: bool) -> Mesh:
    """Drop the parts that no camera sees, such as inner shells and caps over gaps in the data.

    seen [V] bool: the visible vertices. whole_pieces: keep every face of a piece with a visible vertex, so that closed
    surfaces stay closed.
    """
    if whole_pieces:
        count, pieces = mesh.components
        visible = np.bincount(pieces, seen[mesh.faces].any(1), count) > 0
        return mesh.keep_faces(visible[pieces])
    ring = _grown(_grown(seen, mesh), mesh)
    return mesh.keep_faces(ring[mesh.faces].all(1))


def _grown(marked: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Mark the neighbours of marked vertices [V] bool too, because creases hide single visible vertices."""
    grown = marked.copy()
    grown[mesh.faces[marked[mesh.faces].any(1)]] = True
    return grown


def close_loops(mesh: Mesh) -> Mesh:
    """Close every boundary loop by a fan of faces around the loop's centroid."""
    boundary, loops = boundary_loops(mesh)
    if len(boundary) == 0:
        return mesh
    vertices, counts = mesh.vertices, np.bincount(loops)
    sums = np.stack([np.bincount(loops, vertices[boundary[:, 0], axis]) for axis in range(3)], axis=1)
    fan = np.column_stack([boundary[:, 1], boundary[:, 0], len(vertices) + loops])
    return Mesh(np.concatenate([vertices, sums / counts[:, None]]), np.concatenate([mesh.faces, fan]))
