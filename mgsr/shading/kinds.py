"""How each kind of light explains a mesh's shading: read the photographs, and say what normals they ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse

from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, mean_normals, spread
from mgsr.geometry.triangles import vertex_normals
from mgsr.shading.explained import Explained
from mgsr.shading.flash import Flash, explain_by_flash
from mgsr.shading.flash_fit import fit_flash
from mgsr.shading.hollows import find_hollows
from mgsr.shading.mirroring import explain_by_mirroring
from mgsr.shading.readings import Photograph, Readings, read_photographs

HOLLOWS_EDGE = 4.0  # pixels; of the mesh on which hollows are found
POOL = 2.5  # pixels over which the readings of neighbours are put together
CONVEX = 0.12  # bend, in radians a pixel, from which an edge is left alone: it shows too little of each of its tilts


@dataclass(frozen=True)
class Shot:
    """The photographs, with what reading them at a mesh needs. pixel: its size on the surface."""

    photographs: Sequence[Photograph]
    pixel: float
    threads: int | None

    def read(
        self, vertices: np.ndarray, faces: np.ndarray, lamps: np.ndarray | None = None
    ) -> tuple[Readings, np.ndarray]:
        """The photographs at the vertices, and the vertices' normals [V,3]; lamps: as for `read_photographs`."""
        normals = vertex_normals(vertices, faces).astype(np.float64)
        readings = read_photographs(vertices, faces, normals, self.photographs, self.pixel, self.threads, lamps)
        return readings, normals


class Shading(Protocol):
    """A kind of light."""

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, Explained]:
        """The normals [V,3] that a mesh's vertices have, and what the light says of them. laplacian: `umbrella`."""


class ByFlash:
    """A lamp that moves with the camera. With each call its place is better known, as the mesh is."""

    def __init__(
        self, shot: Shot, vertices: np.ndarray, faces: np.ndarray, readings: Readings, normals: np.ndarray
    ) -> None:
        """readings, normals: of the mesh, with which the lamp's place is first looked for."""
        self._shot = shot
        self._cameras = [photograph.camera for photograph in shot.photographs]
        coarse = coarser(vertices, faces, HOLLOWS_EDGE * shot.pixel)
        self._hollows = find_hollows(*coarse, shot.photographs, shot.pixel, shot.threads)
        self._flash = fit_flash(readings, vertices, normals, self._cameras, self._hollows, Flash())

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, Explained]:
        readings, normals = self._shot.read(vertices, faces, self._flash.lamps(self._cameras))
        self._flash = fit_flash(readings, vertices, normals, self._cameras, self._hollows, self._flash)
        light = self._flash, self._cameras, self._hollows
        return normals, explain_by_flash(readings, vertices, normals, *light, self._shot.threads)


class ByMirroring:
    """Surroundings that stand still, mirrored by the surface."""

    def __init__(self, shot: Shot) -> None:
        self._shot = shot

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, Explained]:
        readings, normals = self._shot.read(vertices, faces)
        pixel = self._shot.pixel
        reach = POOL * pixel / edge_length(vertices, faces)
        still = _near_sharp_edges(vertices, laplacian, normals, pixel, reach)
        return normals, explain_by_mirroring(readings, normals, laplacian, reach, still, self._shot.threads)


def _near_sharp_edges(
    vertices: np.ndarray, laplacian: sparse.csr_matrix, normals: np.ndarray, pixel: float, reach: float
) -> np.ndarray:
    """1 at vertices beside a sharp convex edge, 0 far from all, [V]."""
    steps = laplacian @ vertices
    length = np.sqrt(np.maximum((laplacian @ (vertices**2)).sum(1) - 2 * (vertices * steps).sum(1), 1e-20))
    smooth = mean_normals(normals, laplacian, rounds=1)
    bend = -(steps * smooth).sum(1) * 4 / length**2 * pixel
    sharp = (spread(bend[:, None], laplacian, 0.7)[:, 0] > CONVEX).astype(float)
    return np.clip(4 * spread(sharp[:, None], laplacian, max(reach, 0.7))[:, 0], 0, 1)
