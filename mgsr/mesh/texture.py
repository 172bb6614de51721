"""Texturing of the mesh: xatlas unfolds the surface, and the views give the texels' colours."""

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

# Texels between two charts. They take the nearest chart's colours, so that neither bilinear sampling nor mipmaps mix in
# a background.
_PADDING = 4
# Texels in a batch, to bound the memory for all views' samples.
_TEXELS_AT_ONCE = 1 << 19
_ROWS_AT_ONCE = 256
# Pixel footprints by which the depths around a pixel may differ; more is an occlusion edge.
_EDGE = 10.0


def require_unfolding() -> None:
    """Check that the optional package xatlas is installed, so that a run fails before training.

    Raises MeshError if it is not.
    """
    if find_spec("xatlas") is None:
        raise MeshError("output.texture: the texture requires the package xatlas; run pip install 'mgsr[worker]'")


def texture_mesh(
    mesh: ReconstructedMesh,
    views: Sequence[SurfaceView],
    side: int,
    max_faces: int | None,
    config: MeshConfig,
    threads: int | None = None,
) -> TexturedMesh:
    """Reduce the mesh to `max_faces`, and compute its texture of side x side texels.

    mesh, views: in one frame. max_faces: None keeps all faces. Each texel blends the views that see its point, as in
    `seen_colors`, but visibility comes from ray casting the mesh, and pixels at occlusion edges do not count. A texel
    that no view sees takes its colour from the mesh's vertices.

    Raises MeshError if xatlas is not installed.
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
    """Unfold the surface into texture charts.

    Returns the original vertex [W] of each new vertex, the faces [F,3] of new vertices, and the new vertices' texture
    coordinates [W,2], 0..1.
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
    """Replace a view's depth by the mesh's, and mask out pixels at occlusion edges, which mix two colours."""
    hits = caster.cast(view.camera)
    inside = _inside(hits, view)
    return replace(view, depth=hits.depth, mask=inside if view.mask is None else inside & view.mask)


def _inside(hits: RayHits, view: SurfaceView) -> np.ndarray:
    """Return the pixels [H,W] bool that show the surface away from its occlusion edges."""
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
    """Return the texture [S,S,3] uint8 sRGB.

    Texels whose centres lie on a chart take their colours from the views; the others take the nearest such texel's.
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
    """Interpolation of a mesh's vertex colours."""

    def __init__(self, mesh: ReconstructedMesh) -> None:
        self._mesh = mesh

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return the colours [P,3] sRGB 0..1 of the mesh at its nearest points to the points [P,3]."""
        faces, shares = self._mesh.caster.nearest(points)
        return _blend(self._mesh.colors, self._mesh.faces[faces], shares)


def _charted(unfolded: TexturedMesh, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the texels whose centres lie on a chart, by ray casting the unfolded surface.

    Returns their flat indices [T] in row order, the face [T] at each, and its barycentric coordinates [T,3] there.
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
    """Interpolate vertex values [V,C] in triangles; corners [P,3]: vertex indices; shares [P,3]: barycentric."""
    blended: np.ndarray = np.einsum("pkc,pk->pc", values[corners], shares)
    return blended


def _fill_nearest(picture: np.ndarray, texels: np.ndarray) -> np.ndarray:
    """Fill all other texels of a picture [S,S,3] with the colour of the nearest given texel.

    texels [T]: flat indices of the given texels, in row order. Returns the picture [S,S,3].
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
