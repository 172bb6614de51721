"""Baking of a full surface into the texture of a mesh with fewer faces: colour, normals and occlusion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mgsr.config import MeshConfig
from mgsr.config.expert import ColorOptions, TextureOptions
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster, RayHits
from mgsr.geometry.triangles import unit_vectors
from mgsr.mesh.colors import PointsInViews, blended_colors
from mgsr.mesh.sharpening import sharpened
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.mesh.unwrap import UnwrappedMesh
from mgsr.mesh.views import SurfaceView

# Texels and rows of texels in a batch, to bound the memory.
_TEXELS_AT_ONCE = 1 << 19
_ROWS_AT_ONCE = 256


@dataclass(frozen=True)
class Texels:
    """The texels whose centres lie on a chart.

    size: the picture's height and width.
    index [T]: the flat indices of the texels, in row order.
    face [T]: the face of the unwrapped mesh at each texel.
    shares [T,3]: the barycentric coordinates of the texel in that face.
    points [T,3], normals [T,3]: the nearest point of the full surface, and its unit normal. If that normal faces
    another way, as on the other side of a thin sheet, both are those of the unwrapped mesh.
    """

    size: tuple[int, int]
    index: np.ndarray
    face: np.ndarray
    shares: np.ndarray
    points: np.ndarray
    normals: np.ndarray

    def picture(self, values: np.ndarray) -> np.ndarray:
        """Return the picture [H,W,...] of values [T,...]; texels outside the charts take the nearest texel's value."""
        height, width = self.size
        filled = np.zeros((height * width, *values.shape[1:]), values.dtype)
        filled[self.index] = values
        if not len(self.index):
            return filled.reshape(height, width, *values.shape[1:])
        empty = np.ones((height, width), np.uint8)
        empty.ravel()[self.index] = 0
        _, labels = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        sources = np.zeros(labels.max() + 1, np.int64)
        sources[labels.ravel()[self.index]] = self.index
        return np.asarray(filled[sources[labels]])


def find_texels(unwrapped: UnwrappedMesh, full: Mesh, same_side: float = TextureOptions().same_side) -> Texels:
    """Find the texels of an unwrapped mesh, and the points and normals of the full surface at them.

    same_side: if the cosine between the normals of both meshes is lower, they are different sides of a sheet.
    """
    index, face, shares = _charted(unwrapped)
    places = interpolated(unwrapped.vertices, unwrapped.faces[face], shares)
    nearest, at = full.caster.nearest(places)
    points = interpolated(full.vertices, full.faces[nearest], at)
    normals = unit_vectors(interpolated(full.normals, full.faces[nearest], at))
    own = unit_vectors(interpolated(unwrapped.normals, unwrapped.faces[face], shares))
    alike = (normals * own).sum(axis=1, keepdims=True) > same_side
    return Texels(unwrapped.size, index, face, shares, points, np.where(alike, normals, own))


def bake_colors(
    texels: Texels,
    full: ReconstructedMesh,
    views: Sequence[SurfaceView],
    config: MeshConfig,
    threads: int | None = None,
    options: ColorOptions = ColorOptions(),
) -> np.ndarray:
    """Return the texels' colours [T,3] float32 sRGB 0..1.

    Each blends the views that see its place, as in `blended_colors`, but visibility comes from ray casting the full
    surface, and pixels at occlusion edges do not count. A texel that no view sees takes the vertices' colours. The
    blended colours are then sharpened (`mgsr.mesh.sharpening`).
    """
    visible = [_with_depth_of(full.caster, view, options.occlusion_edge) for view in views]
    tolerance = config.consistency or options.tolerance
    points = PointsInViews(texels.points, texels.normals, visible, config.min_alpha, tolerance, options.grazing)
    colors, seen = blended_colors(points, threads, options)
    face, shares = full.caster.nearest(texels.points[~seen])
    colors[~seen] = interpolated(full.colors, full.faces[face], shares)
    return sharpened(colors, points, threads, options)


def bake_normals(texels: Texels, unwrapped: UnwrappedMesh, min_z: float = TextureOptions().min_z) -> np.ndarray:
    """Return the normals [T,3] of the full surface in the tangent space of the unwrapped mesh, unit.

    x runs along the tangent, y along the bitangent, z along the normal. As in MikkTSpace, the three are interpolated
    without normalisation. A renderer that does the same reproduces the full surface's normals.

    min_z: the least z, because renderers show black where the mapped normal points into the surface.
    """
    baked = np.empty((len(texels.index), 3), np.float32)
    axes = np.stack([unwrapped.tangents[:, :3], unwrapped.bitangents(), unwrapped.normals], axis=2)
    for start in range(0, len(texels.index), _TEXELS_AT_ONCE):
        part = slice(start, start + _TEXELS_AT_ONCE)
        frame = np.einsum("pkij,pk->pij", axes[unwrapped.faces[texels.face[part]]], texels.shares[part])
        turned = np.linalg.solve(frame + 1e-9 * np.eye(3), texels.normals[part][..., None])[..., 0]
        turned[turned[:, 2] < min_z, 2] = min_z
        baked[part] = unit_vectors(turned)
    return baked


def _charted(unwrapped: UnwrappedMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the texels whose centres lie on a chart, by ray casting the flat charts.

    Returns their flat indices [T] in row order, the face [T] at each, and its barycentric coordinates [T,3] there.
    """
    height, width = unwrapped.size
    flat = np.zeros((len(unwrapped.uvs), 3), np.float32)
    flat[:, :2] = unwrapped.uvs * (width, height)
    caster = Mesh(flat, unwrapped.faces).caster
    index, faces, shares = [], [], []
    for top in range(0, height, _ROWS_AT_ONCE):
        rows, columns = np.mgrid[top : min(top + _ROWS_AT_ONCE, height), :width].astype(np.float32) + 0.5
        above = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
        hits = caster.cast_rays(above, np.broadcast_to(np.array([0, 0, -1], np.float32), above.shape))
        index.append(np.flatnonzero(hits.mask) + top * width)
        faces.append(hits.face[hits.mask])
        shares.append(hits.barycentric[hits.mask])
    return np.concatenate(index), np.concatenate(faces), np.concatenate(shares)


def _with_depth_of(caster: RayCaster, view: SurfaceView, edge: float) -> SurfaceView:
    """Replace a view's depth by the mesh's, and mask out pixels at occlusion edges, which mix two colours."""
    hits = caster.cast(view.camera)
    inside = _inside(hits, view, edge)
    return replace(view, depth=hits.depth, mask=inside if view.mask is None else inside & view.mask)


def _inside(hits: RayHits, view: SurfaceView, edge: float) -> np.ndarray:
    """Return the pixels [H,W] bool that show the surface away from its occlusion edges."""
    around = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(hits.depth, around), cv2.dilate(hits.depth, around)
    inside: np.ndarray = (nearest > 0) & (farthest - nearest <= edge * hits.depth / view.camera.K[0, 0])
    return inside


def interpolated(values: np.ndarray, corners: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Interpolate vertex values [V,C] in triangles; corners [P,3]: vertex indices; shares [P,3]: barycentric."""
    blended: np.ndarray = np.einsum("pkc,pk->pc", values[corners], shares)
    return blended
