"""The triangle mesh of the whole library, with derived quantities that are computed once."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from mgsr.geometry.raycast import RayCaster


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    vertices [V,3]: in any frame and unit. faces [F,3]: vertex indices, counter-clockwise from outside. Neither array
    may be changed in place, as derived quantities are cached.
    """

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def area(self) -> float:
        """Return the area of all faces, in the vertices' unit squared."""
        return float(np.linalg.norm(self.face_crosses, axis=1).sum()) / 2

    @cached_property
    def face_crosses(self) -> np.ndarray:
        """Return the face normals [F,3], each with the length of twice the face's area."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def normals(self) -> np.ndarray:
        """Return unit vertex normals [V,3] float32: area-weighted means over the faces; 0 without a face."""
        crosses, corners, count = self.face_crosses, self.faces.ravel(), len(self.vertices)
        sums = np.stack([np.bincount(corners, np.repeat(crosses[:, axis], 3), count) for axis in range(3)], axis=1)
        lengths = np.linalg.norm(sums, axis=1, keepdims=True)
        return np.asarray((sums / np.maximum(lengths, 1e-20)).astype(np.float32))

    @cached_property
    def double_normals(self) -> np.ndarray:
        """Return `normals` as float64 [V,3]."""
        return self.normals.astype(np.float64)

    @cached_property
    def edges(self) -> np.ndarray:
        """Return the edges [E,2], each once, the lower vertex index first."""
        sides = np.sort(self._sides.astype(np.int64), axis=1)
        width = 1 + (int(sides.max()) if len(sides) else 0)
        return np.stack(np.divmod(np.unique(sides[:, 0] * width + sides[:, 1]), width), axis=1)

    @cached_property
    def edge_length(self) -> float:
        """Return the mean length of the faces' sides, in the vertices' unit; a side of two faces counts twice."""
        corners = self.vertices[self.faces]
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean())

    @cached_property
    def laplacian(self) -> sparse.csr_matrix:
        """Return the uniform Laplacian [V,V].

        A row gives the mean of a vertex's neighbours minus the vertex itself. It is 0 for a vertex without neighbours.
        """
        count = len(self.vertices)
        sides = np.concatenate([self._sides, self._sides[:, ::-1]])
        ones = np.ones(len(sides), np.float64)
        joined = sparse.coo_matrix((ones, (sides[:, 0], sides[:, 1])), (count, count)).tocsr()
        joined.data[:] = 1
        counts = np.asarray(joined.sum(axis=1)).ravel()
        return (sparse.diags(1 / np.maximum(counts, 1)) @ joined - sparse.diags((counts > 0) * 1.0)).tocsr()

    @cached_property
    def components(self) -> tuple[int, np.ndarray]:
        """Return the number of connected components, and each face's component [F].

        Faces that share a vertex are connected.
        """
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]]])
        graph = sparse.coo_matrix((np.ones(len(edges), bool), edges.T), (len(self.vertices),) * 2)
        _, labels = connected_components(graph, directed=False)
        used, pieces = np.unique(labels[self.faces[:, 0]], return_inverse=True)
        return len(used), pieces

    @cached_property
    def caster(self) -> RayCaster:
        """Return the mesh prepared for ray casting."""
        return RayCaster(self.vertices, self.faces)

    def prolongation(self, points: np.ndarray) -> sparse.csr_matrix:
        """Return the matrix [P,V] that interpolates vertex values at points [P,3] near the mesh.

        Each point takes the value at the nearest point of the mesh, by barycentric interpolation.
        """
        face, shares = self.caster.nearest(points)
        places = (np.repeat(np.arange(len(points)), 3), self.faces[face].ravel())
        size = (len(points), len(self.vertices))
        return sparse.coo_matrix((shares.ravel().astype(np.float64), places), size).tocsr()

    def moved(self, vertices: np.ndarray) -> Self:
        """Return the mesh with its vertices moved to new positions [V,3]."""
        mesh = replace(self, vertices=vertices)
        mesh.__dict__.update({name: self.__dict__[name] for name in _OF_FACES if name in self.__dict__})
        return mesh

    def with_normals(self, normals: np.ndarray) -> Self:
        """Return the mesh with given vertex normals [V,3] instead of those of its faces."""
        mesh = copy(self)
        mesh.__dict__.pop("double_normals", None)
        mesh.__dict__["normals"] = normals
        return mesh

    def in_frame(self, vertices: np.ndarray) -> Self:
        """Return the mesh in another frame that is scaled and shifted but not rotated, so its normals stay.

        vertices [V,3]: the vertices in the other frame.
        """
        return self.moved(vertices).with_normals(self.normals)

    def keep_faces(self, keep: np.ndarray) -> Mesh:
        """Return the mesh of the faces where keep [F] bool is True, without unused vertices."""
        faces = self.faces[keep]
        used, inverse = np.unique(faces, return_inverse=True)
        return Mesh(self.vertices[used], inverse.reshape(-1, 3))

    @property
    def _sides(self) -> np.ndarray:
        """Return the sides of all faces as vertex indices [3F,2], in the faces' orientation."""
        return np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])


_OF_FACES = ("edges", "laplacian", "components")  # cached quantities that depend on the faces alone
