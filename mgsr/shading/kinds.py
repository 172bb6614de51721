"""Light models: how a flash or an environment map explains a mesh's shading, and the normals that they ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, edges, mean_normals, spread
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import vertex_normals
from mgsr.shading.explained import Explained
from mgsr.shading.flash import Flash, albedos, explain_by_flash
from mgsr.shading.flash_fit import fit_flash
from mgsr.shading.hollows import Hollows, find_hollows
from mgsr.shading.lighting import Lighting, lamp_light
from mgsr.shading.mirroring import explain_by_mirroring
from mgsr.shading.mixing import unmixed
from mgsr.shading.readings import Photograph, Readings, read_photographs
from mgsr.shading.surroundings import Surroundings, fit_surroundings

HOLLOWS_EDGE = 4.0  # pixels; of the mesh on which hollows are found
MIRRORING_EDGE = 2.0  # pixels; of the mesh from which the surroundings are fitted
LIT_EDGE = 1.5  # pixels; of the mesh that carries a flash's light
FINE = 1.25  # pixels; edges of a mesh under which it shows what pixels mix
BRIGHTEST = 0.995  # of the places that photographs show; one that is brighter counts as bright as these
FRONTAL = 0.5  # cosine of the tilt under which gloss mirrors more than one map for all tilts can tell (Fresnel)
POOL = 2.5  # pixels over which the readings of neighbours are put together
CONVEX = 0.12  # bend, in radians a pixel, from which an edge is left alone: it shows too little of each of its tilts


@dataclass(frozen=True)
class Shot:
    """The photographs of a capture, with what reading them at a mesh needs; pixel: a pixel's size on the surface."""

    photographs: Sequence[Photograph]
    pixel: float
    threads: int | None

    def read(
        self, vertices: np.ndarray, faces: np.ndarray, lamps: np.ndarray | None = None
    ) -> tuple[Readings, np.ndarray]:
        """Read the photographs at a mesh's vertices, and return the readings with the vertices' normals [V,3].

        lamps: as for `read_photographs`.
        """
        normals = vertex_normals(vertices, faces).astype(np.float64)
        readings = read_photographs(vertices, faces, normals, self.photographs, self.pixel, self.threads, lamps)
        return readings, normals


class Shading(Protocol):
    """A light model."""

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, Explained]:
        """Return the normals [V,3] of a mesh's vertices, and the normals that the light asks for.

        laplacian: the mesh's uniform Laplacian (`umbrella`).
        """

    def lighting(self, vertices: np.ndarray, faces: np.ndarray) -> Lighting | None:
        """Return how the light falls on a mesh, where it comes with the camera; else None."""

    def surroundings(self, vertices: np.ndarray, faces: np.ndarray) -> Surroundings | None:
        """Return the environment map that a mesh mirrors, where the light stands still; else None."""


class ByFlash:
    """A lamp that moves with the camera; each call of `explain` refines its place, as the mesh is refined."""

    def __init__(
        self, shot: Shot, vertices: np.ndarray, faces: np.ndarray, readings: Readings, normals: np.ndarray
    ) -> None:
        """Estimate the lamp from the readings and normals [V,3] of a mesh."""
        self._shot = shot
        self._cameras = [photograph.camera for photograph in shot.photographs]
        self._hollows = self._find_hollows(vertices, faces)
        self._flash = fit_flash(readings, vertices, normals, self._cameras, self._hollows, Flash())

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, Explained]:
        readings, normals = self._shot.read(vertices, faces, self._flash.lamps(self._cameras))
        seen = self._cameras, self._hollows
        self._flash = fit_flash(readings, vertices, normals, *seen, self._flash)
        if edge_length(vertices, faces) < FINE * self._shot.pixel:
            readings = self._unmixed(readings, vertices, faces, normals)
            self._flash = fit_flash(readings, vertices, normals, *seen, self._flash)
        return normals, explain_by_flash(readings, vertices, normals, self._flash, *seen, self._shot.threads)

    def lighting(self, vertices: np.ndarray, faces: np.ndarray) -> Lighting:
        vertices, faces = coarser(vertices, faces, LIT_EDGE * self._shot.pixel)
        lamps, hollows = self._flash.lamps(self._cameras), self._find_hollows(vertices, faces)
        readings, normals = self._shot.read(vertices, faces, lamps)
        flash = fit_flash(readings, vertices, normals, self._cameras, hollows, self._flash)
        sky, thrown = hollows.at(vertices, readings.photographs)
        # What hollows throw back is as the photographs that show the place have it, on average: it changes little.
        seen = readings.weights > 0
        bounced = (thrown * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        besides = flash.ambient * sky + flash.bounced * bounced
        light = lamp_light(lamps[readings.photographs] - vertices[:, None], normals[:, None]) + besides[:, None]
        most = float(np.quantile(light[seen], BRIGHTEST)) if seen.any() else 1.0
        like = _nearest(np.asarray(seen.any(axis=1)), vertices, edges(faces))
        return Lighting(vertices, faces, besides / most, like, flash.right, flash.down, 1 / most)

    def surroundings(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        return None

    def _unmixed(self, readings: Readings, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> Readings:
        """Return the readings at a mesh's vertices, corrected for the footprints of pixels (`unmixed`).

        normals [V,3]: the vertices'.
        """
        flash, lamps, caster = self._flash, self._flash.lamps(self._cameras), RayCaster(vertices, faces)
        paint = albedos(readings, vertices, normals, flash, self._cameras, self._hollows)
        paint = paint[_nearest(readings.counts > 0, vertices, edges(faces))]
        sky, thrown = self._hollows.at(vertices, np.broadcast_to(np.arange(len(lamps)), (len(vertices), len(lamps))))
        gap = self._shot.pixel

        def shown(number: int, some: np.ndarray) -> np.ndarray:
            places, facing, opened = vertices[some], normals[some], sky[some]
            lamp = lamp_light(lamps[number] - places, facing)
            shaded = np.flatnonzero(opened < 1)
            lamp[shaded] *= caster.reached(lamps[number], places[shaded] + gap * facing[shaded], gap)
            return np.asarray(paint[some] * (lamp + flash.ambient * opened + flash.bounced * thrown[some, number]))

        return unmixed(readings, caster, vertices, faces, self._shot.photographs, shown, self._shot.threads)

    def _find_hollows(self, vertices: np.ndarray, faces: np.ndarray) -> Hollows:
        coarse = coarser(vertices, faces, HOLLOWS_EDGE * self._shot.pixel)
        return find_hollows(*coarse, self._shot.photographs, self._shot.pixel, self._shot.threads)


class ByMirroring:
    """An environment that stands still and is mirrored by the surface."""

    def __init__(self, shot: Shot) -> None:
        self._shot = shot

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, Explained]:
        readings, normals = self._shot.read(vertices, faces)
        pixel = self._shot.pixel
        reach = POOL * pixel / edge_length(vertices, faces)
        still = _near_sharp_edges(vertices, laplacian, normals, pixel, reach)
        explained = explain_by_mirroring(
            readings.frontal(FRONTAL), normals, laplacian, reach, still, self._shot.threads
        )
        return normals, explained

    def lighting(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        return None

    def surroundings(self, vertices: np.ndarray, faces: np.ndarray) -> Surroundings:
        return mirrored_surroundings(*self._shot.read(*coarser(vertices, faces, MIRRORING_EDGE * self._shot.pixel)))


def mirrored_surroundings(readings: Readings, normals: np.ndarray) -> Surroundings:
    """Fit the environment map that points with normals [P,3] mirror, from their readings under FRONTAL's tilt alone."""
    return fit_surroundings(readings.frontal(FRONTAL), normals)


def _nearest(wanted: np.ndarray, vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return for each vertex [V,3] the nearest wanted vertex along the edges [E,2], by index [V].

    wanted [V] bool. A vertex from which no path leads to a wanted one gets its own index.
    """
    own = np.arange(len(vertices))
    if not wanted.any():
        return own
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    ways = sparse.coo_matrix((lengths, edges.T), (len(vertices), len(vertices))).tocsr()
    sources = csgraph.dijkstra(
        ways, directed=False, indices=np.flatnonzero(wanted), min_only=True, return_predecessors=True
    )[2]
    return np.asarray(np.where(sources >= 0, sources, own))


def _near_sharp_edges(
    vertices: np.ndarray, laplacian: sparse.csr_matrix, normals: np.ndarray, pixel: float, reach: float
) -> np.ndarray:
    """Return how near each vertex lies to a sharp convex edge, [V]: from 1 beside one to 0 far from all."""
    steps = laplacian @ vertices
    length = np.sqrt(np.maximum((laplacian @ (vertices**2)).sum(1) - 2 * (vertices * steps).sum(1), 1e-20))
    smooth = mean_normals(normals, laplacian, rounds=1)
    bend = -(steps * smooth).sum(1) * 4 / length**2 * pixel
    sharp = (spread(bend[:, None], laplacian, 0.7)[:, 0] > CONVEX).astype(float)
    nearness: np.ndarray = np.clip(4 * spread(sharp[:, None], laplacian, max(reach, 0.7))[:, 0], 0, 1)
    return nearness
