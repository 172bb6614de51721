"""Texturing of the mesh in place of vertex colours: the surface is unfolded by xatlas and painted from the views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec

import cv2
import numpy as np

from mgsr.config import MeshConfig
from mgsr.errors import MeshError
from mgsr.geometry.decimate import decimate
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster, RayHits
from mgsr.mesh.colors import TOLERANCE, seen_colors
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.views import SurfaceView

# Texels between two charts. What lies between is filled with the nearest chart's colours, so that neither bilinear
# reading nor the smaller copies that viewers make mix in a background.
_PADDING = 4
# Views are read for so many texels at a time: each keeps its colours until all have been seen.
_TEXELS_AT_ONCE = 1 << 19
_ROWS_AT_ONCE = 256
# Footprints by which the depths of a pixel and its neighbours may differ; more is an edge with something else behind.
_EDGE = 10.0


def require_unfolding() -> None:
    """Check that xatlas, which an extra brings, is installed, so that a run fails before it trains.

    Raises MeshError where it is not.
    """
    if find_spec("xatlas") is None:
        raise MeshError("output.texture: unfolding the surface needs the package xatlas: pip install 'mgsr[worker]'")


def texture_mesh(
    mesh: ReconstructedMesh,
    views: Sequence[SurfaceView],
    side: int,
    max_faces: int | None,
    config: MeshConfig,
    threads: int | None = None,
) -> TexturedMesh:
    """Reduce the mesh to `max_faces`, and paint a texture of side x side texels for it.

    Each texel takes the mean of the views that see its place as `seen_colors` tells, with one difference: what hides it
    is found by ray casting the mesh itself, and pixels on the edge of something nearer are left out. What no view sees
    takes the colours of the mesh's vertices. mesh and views share a frame.

    Raises MeshError where xatlas is not installed.
    """
    require_unfolding()
    plain = Mesh(mesh.vertices, mesh.faces)
    if max_faces is not None:
        plain = decimate(plain, max_faces)
    origin, corners, uvs = _unfold(plain, side)
    blank = np.zeros((side, side, 3), np.uint8)
    unfolded = TexturedMesh(plain.vertices[origin], corners, uvs, blank).with_normals(plain.normals[origin])
    visible = [_with_depth_of(plain.caster, view) for view in views]
    return replace(unfolded, picture=_paint(unfolded, mesh, visible, config, threads)).with_normals(unfolded.normals)


def _unfold(mesh: Mesh, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unfold the surface into charts laid side by side.

    Returns the original vertex of each new one [W], faces [F,3] of new vertices, and the new vertices' texture
    coordinates [W,2] in 0..1.
    """
    import xatlas  # late: only textures need it

    vertices, faces = mesh.vertices, mesh.faces
    middle = (vertices.max(0) + vertices.min(0)) / 2
    atlas = xatlas.Atlas()
    atlas.add_mesh((vertices - middle).astype(np.float32), faces.astype(np.uint32))
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding, pack.bilinear = side, _PADDING, True
    atlas.generate(xatlas.ChartOptions(), pack)
    origin, corners, uvs = atlas[0]
    return origin.astype(np.int64), corners.astype(np.int64), uvs


def _with_depth_of(caster: RayCaster, view: SurfaceView) -> SurfaceView:
    """Return the view with the mesh's own depth, and without pixels at its edges, which mix two surfaces' colours."""
    hits = caster.cast(view.camera)
    inside = _inside(hits, view)
    return replace(view, depth=hits.depth, mask=inside if view.mask is None else inside & view.mask)


def _inside(hits: RayHits, view: SurfaceView) -> np.ndarray:
    around = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(hits.depth, around), cv2.dilate(hits.depth, around)
    inside: np.ndarray = (nearest > 0) & (farthest - nearest <= _EDGE * hits.depth / view.camera.K[0, 0])
    return inside


def _paint(
    unfolded: TexturedMesh,
    mesh: ReconstructedMesh,
    views: Sequence[SurfaceView],
    config: MeshConfig,
    threads: int | None,
) -> np.ndarray:
    """Paint the texture [S,S,3] uint8.

    Texels whose middles lie on a chart are painted from the views; the rest take the nearest one's colour.
    """
    side = len(unfolded.picture)
    tolerance = config.consistency or TOLERANCE
    texels, faces, shares = _charted(unfolded, side)
    corners = unfolded.faces[faces]
    plain = _VertexColors(mesh)
    painted = np.zeros((len(texels), 3), np.float32)
    for start in range(0, len(texels), _TEXELS_AT_ONCE):
        part = slice(start, start + _TEXELS_AT_ONCE)
        points = _blend(unfolded.vertices, corners[part], shares[part])
        normals = _blend(unfolded.normals, corners[part], shares[part])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        colors, seen = seen_colors(points, normals, views, config.min_alpha, tolerance, threads)
        colors[~seen] = plain.at(points[~seen])
        painted[part] = colors
    picture = np.zeros((side * side, 3), np.uint8)
    picture[texels] = np.rint(np.clip(painted, 0, 1) * 255)
    return _fill_nearest(picture.reshape(side, side, 3), texels)


class _VertexColors:
    """The mesh's own colours at any point beside it."""

    def __init__(self, mesh: ReconstructedMesh) -> None:
        self._mesh = mesh

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return the colours [P,3] of the mesh's places nearest to the points [P,3]."""
        faces, shares = self._mesh.caster.nearest(points)
        return _blend(self._mesh.colors, self._mesh.faces[faces], shares)


def _charted(unfolded: TexturedMesh, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the texels [T], counted row by row, whose middles lie on a chart, by ray casting the unfolded surface.

    Also returns the face [T] there and the barycentric coordinates [T,3] on it.
    """
    flat = np.zeros((len(unfolded.uvs), 3), np.float32)
    flat[:, :2] = unfolded.uvs * side
    caster = Mesh(flat, unfolded.faces).caster
    texels, faces, shares = [], [], []
    for top in range(0, side, _ROWS_AT_ONCE):
        rows, columns = np.mgrid[top : min(top + _ROWS_AT_ONCE, side), :side].astype(np.float32) + 0.5
        above = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
        hits = caster.cast_rays(above, np.broadcast_to(np.array([0, 0, -1], np.float32), above.shape))
        texels.append(np.flatnonzero(hits.mask) + top * side)
        faces.append(hits.face[hits.mask])
        shares.append(hits.barycentric[hits.mask])
    return np.concatenate(texels), np.concatenate(faces), np.concatenate(shares)


def _blend(values: np.ndarray, corners: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Interpolate values [V,...] at vertices `corners` [P,3] by their shares [P,3]."""
    blended: np.ndarray = np.einsum("pkc,pk->pc", values[corners], shares)
    return blended


def _fill_nearest(picture: np.ndarray, texels: np.ndarray) -> np.ndarray:
    """Fill every texel but the given ones with the nearest given one's colour.

    picture [S,S,3]; texels [T]: counted row by row.
    """
    if len(texels) == 0:
        return picture
    empty = np.ones(picture.shape[:2], np.uint8)
    empty.ravel()[texels] = 0
    _, labels = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    sources = np.zeros(labels.max() + 1, np.int64)
    sources[labels.ravel()[texels]] = texels
    filled: np.ndarray = picture.reshape(-1, 3)[sources[labels]]
    return filled
