"""Unwrapping of a surface into a texture atlas, with the tangent space of its normal map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import UnwrapOptions
from mgsr.geometry.charts import cut_charts
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.packing import pack_charts


@dataclass(frozen=True, eq=False)
class UnwrappedMesh(Mesh):
    """A mesh with texture coordinates. A vertex on several charts of the atlas is repeated for each.

    uvs [V,2]: float32, 0..1 from the upper left corner. tangents [V,4]: float32, unit, along increasing u; the fourth
    number is the sign of the bitangent (`tangent_space`). size: the atlas's height and width in texels.
    """

    uvs: np.ndarray
    tangents: np.ndarray
    size: tuple[int, int]

    def bitangents(self) -> np.ndarray:
        """Return the bitangents [V,3], along decreasing v: sign x (normal x tangent), as in glTF."""
        return np.asarray(self.tangents[:, 3:] * np.cross(self.normals, self.tangents[:, :3]))


def unwrap(
    mesh: Mesh, texel: float, side: int | None = None, options: UnwrapOptions = UnwrapOptions()
) -> UnwrappedMesh:
    """Unwrap a mesh, with its normals.

    texel: the size of a texel in the mesh's unit; larger if the atlas would exceed `options.max_side`. side: the texels
    along each side of a square atlas instead, whatever their size.
    """
    limit = side or options.max_side
    full = (mesh.area / options.filled) ** 0.5 / limit
    texel = max(texel, full) if side is None else full
    charts = cut_charts(mesh, (options.min_chart * texel) ** 2, options.charts)
    atlas = pack_charts(charts, texel, side, options)
    uvs = (atlas.places / atlas.size[::-1]).astype(np.float32)
    size = atlas.size if side is None else (side, side)
    origin = charts.origin[atlas.origin]
    normals, vertices = mesh.normals[origin], mesh.vertices[origin]
    tangents = tangent_space(Mesh(vertices, atlas.faces).with_normals(normals), uvs * size[::-1])
    unwrapped: UnwrappedMesh = UnwrappedMesh(vertices, atlas.faces, uvs, tangents, size).with_normals(normals)
    return unwrapped


def tangent_space(mesh: Mesh, places: np.ndarray) -> np.ndarray:
    """Return the tangents [V,4] of a mesh with its normals: unit tangents, and the sign of the bitangents.

    places [V,2]: the vertices' places in the picture, x right and y down. A vertex's tangent is the mean of its faces'
    tangents in the plane of its normal, each weighted by the face's angle there (MikkTSpace; Mikkelsen, 2008).

    MikkTSpace repeats vertices between faces of opposite orientation. Here the orientation with the larger total angle
    counts, because all but tiny faces of a chart have the same orientation.
    """
    faces, normals = mesh.faces, mesh.double_normals
    corners, flat = mesh.vertices[faces], places[faces].astype(np.float64)
    (first, second), (one, two) = ((each[:, 1] - each[:, 0], each[:, 2] - each[:, 0]) for each in (corners, flat))
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    along = np.sign(area)[:, None] * (first * two[:, 1:] - second * one[:, 1:])
    sums, orientation = np.zeros((len(places), 3)), np.zeros(len(places))
    for corner in range(3):
        index, at = faces[:, corner], corners[:, corner]
        normal = normals[index]
        sides = [_unit(_in_plane(corners[:, (corner + step) % 3] - at, normal)) for step in (1, 2)]
        angle = np.arccos(np.clip((sides[0] * sides[1]).sum(axis=1), -1, 1)) * (area != 0)
        weighted = angle[:, None] * _unit(_in_plane(along, normal))
        for axis in range(3):
            sums[:, axis] += np.bincount(index, weighted[:, axis], len(places))
        orientation += np.bincount(index, angle * -np.sign(area), len(places))
    tangents = _unit(_in_plane(sums, normals))
    lost = np.linalg.norm(tangents, axis=1) < 0.5
    tangents[lost] = _any_tangents(normals[lost])
    return np.column_stack([tangents, np.where(orientation < 0, -1.0, 1.0)]).astype(np.float32)


def _any_tangents(normals: np.ndarray) -> np.ndarray:
    """Return a unit tangent [P,3] for normals [P,3] of any length; x where a normal is 0."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(axis, normals)
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    return np.where(lengths > 1e-9, across / np.maximum(lengths, 1e-9), [[1.0, 0, 0]])


def _in_plane(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return vectors [P,3] without their parts along unit normals [P,3]."""
    return np.asarray(vectors - (vectors * normals).sum(axis=1, keepdims=True) * normals)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return unit vectors [P,3]; 0 stays 0."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30))
