"""Light models: how a flash or an environment map explains a mesh's shading, and the normals that they ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import diffuse, edge_length, edges, mean_normals
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import vertex_normals
from mgsr.shading.ambient_occlusion import AmbientOcclusion, estimate_occlusion
from mgsr.shading.environment_fit import FittedEnvironmentMap, fit_environment_map
from mgsr.shading.environment_normals import normals_from_environment
from mgsr.shading.flash import Flash, albedos, normals_from_flash
from mgsr.shading.flash_fit import fit_flash
from mgsr.shading.lighting import Lighting, lamp_light
from mgsr.shading.observations import LinearPhotograph, Observations, observe_photographs
from mgsr.shading.pixel_footprint import deconvolve
from mgsr.shading.target_normals import TargetNormals

OCCLUSION_EDGE = 4.0  # pixels; of the mesh on which hollows are found
ENVIRONMENT_EDGE = 2.0  # pixels; of the mesh from which the surroundings are fitted
IRRADIANCE_EDGE = 1.5  # pixels; of the mesh that carries a flash's light
FINE = 1.25  # pixels; edges of a mesh under which it shows what pixels mix
BRIGHTEST = 0.995  # of the places that photographs show; one that is brighter counts as bright as these
FRONTAL = 0.5  # cosine of the tilt under which gloss mirrors more than one map for all tilts can tell (Fresnel)
POOL = 2.5  # pixels over which the readings of neighbours are put together
CONVEX = 0.12  # bend, in radians a pixel, from which an edge is left alone: it shows too little of each of its tilts


@dataclass(frozen=True)
class Shot:
    """The photographs of a capture, with what reading them at a mesh needs; pixel: a pixel's size on the surface."""

    photographs: Sequence[LinearPhotograph]
    pixel: float
    threads: int | None

    def read(
        self, vertices: np.ndarray, faces: np.ndarray, lamps: np.ndarray | None = None
    ) -> tuple[Observations, np.ndarray]:
        """Read the photographs at a mesh's vertices, and return the readings with the vertices' normals [V,3].

        lamps: as for `observe_photographs`.
        """
        normals = vertex_normals(vertices, faces).astype(np.float64)
        observations = observe_photographs(vertices, faces, normals, self.photographs, self.pixel, self.threads, lamps)
        return observations, normals


class LightModel(Protocol):
    """A light model."""

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, TargetNormals]:
        """Return the normals [V,3] of a mesh's vertices, and the normals that the light asks for.

        laplacian: the mesh's uniform Laplacian (`uniform_laplacian`).
        """

    def lighting(self, vertices: np.ndarray, faces: np.ndarray) -> Lighting | None:
        """Return how the light falls on a mesh, where it comes with the camera; else None."""

    def environment(self, vertices: np.ndarray, faces: np.ndarray) -> FittedEnvironmentMap | None:
        """Return the environment map that a mesh mirrors, where the light stands still; else None."""


class FlashLight:
    """A lamp that moves with the camera; each call of `explain` refines its place, as the mesh is refined."""

    def __init__(
        self, shot: Shot, vertices: np.ndarray, faces: np.ndarray, observations: Observations, normals: np.ndarray
    ) -> None:
        """Estimate the lamp from the readings and normals [V,3] of a mesh."""
        self._shot = shot
        self._cameras = [photograph.camera for photograph in shot.photographs]
        self._occlusion = self._estimate_occlusion(vertices, faces)
        self._flash = fit_flash(observations, vertices, normals, self._cameras, self._occlusion, Flash())

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, TargetNormals]:
        observations, normals = self._shot.read(vertices, faces, self._flash.lamps(self._cameras))
        seen = self._cameras, self._occlusion
        self._flash = fit_flash(observations, vertices, normals, *seen, self._flash)
        if edge_length(vertices, faces) < FINE * self._shot.pixel:
            observations = self._deconvolved(observations, vertices, faces, normals)
            self._flash = fit_flash(observations, vertices, normals, *seen, self._flash)
        return normals, normals_from_flash(observations, vertices, normals, self._flash, *seen, self._shot.threads)

    def lighting(self, vertices: np.ndarray, faces: np.ndarray) -> Lighting:
        vertices, faces = coarser(vertices, faces, IRRADIANCE_EDGE * self._shot.pixel)
        lamps, occlusion = self._flash.lamps(self._cameras), self._estimate_occlusion(vertices, faces)
        observations, normals = self._shot.read(vertices, faces, lamps)
        flash = fit_flash(observations, vertices, normals, self._cameras, occlusion, self._flash)
        sky_visibility, interreflection = occlusion.at(vertices, observations.photographs)
        # What hollows throw back is as the photographs that show the place have it, on average: it changes little.
        seen = observations.weights > 0
        bounced = (interreflection * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        ambient = flash.ambient * sky_visibility + flash.bounced * bounced
        light = lamp_light(lamps[observations.photographs] - vertices[:, None], normals[:, None]) + ambient[:, None]
        most = float(np.quantile(light[seen], BRIGHTEST)) if seen.any() else 1.0
        proxy_vertex = _nearest(np.asarray(seen.any(axis=1)), vertices, edges(faces))
        return Lighting(vertices, faces, ambient / most, proxy_vertex, flash.right, flash.down, 1 / most)

    def environment(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        return None

    def _deconvolved(
        self, observations: Observations, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray
    ) -> Observations:
        """Return the readings at a mesh's vertices, corrected for the footprints of pixels (`deconvolve`).

        normals [V,3]: the vertices'.
        """
        flash, lamps, caster = self._flash, self._flash.lamps(self._cameras), RayCaster(vertices, faces)
        paint = albedos(observations, vertices, normals, flash, self._cameras, self._occlusion)
        paint = paint[_nearest(observations.counts > 0, vertices, edges(faces))]
        sky_visibility, interreflection = self._occlusion.at(
            vertices, np.broadcast_to(np.arange(len(lamps)), (len(vertices), len(lamps)))
        )
        gap = self._shot.pixel

        def shown(number: int, some: np.ndarray) -> np.ndarray:
            places, facing, removed_area = vertices[some], normals[some], sky_visibility[some]
            lamp = lamp_light(lamps[number] - places, facing)
            shaded = np.flatnonzero(removed_area < 1)
            lamp[shaded] *= caster.reached(lamps[number], places[shaded] + gap * facing[shaded], gap)
            return np.asarray(
                paint[some] * (lamp + flash.ambient * removed_area + flash.bounced * interreflection[some, number])
            )

        return deconvolve(observations, caster, vertices, faces, self._shot.photographs, shown, self._shot.threads)

    def _estimate_occlusion(self, vertices: np.ndarray, faces: np.ndarray) -> AmbientOcclusion:
        coarse = coarser(vertices, faces, OCCLUSION_EDGE * self._shot.pixel)
        return estimate_occlusion(*coarse, self._shot.photographs, self._shot.pixel, self._shot.threads)


class EnvironmentLight:
    """An environment that stands still and is mirrored by the surface."""

    def __init__(self, shot: Shot) -> None:
        self._shot = shot

    def explain(
        self, vertices: np.ndarray, faces: np.ndarray, laplacian: sparse.csr_matrix
    ) -> tuple[np.ndarray, TargetNormals]:
        observations, normals = self._shot.read(vertices, faces)
        pixel = self._shot.pixel
        reach = POOL * pixel / edge_length(vertices, faces)
        still = _near_sharp_edges(vertices, laplacian, normals, pixel, reach)
        explained = normals_from_environment(
            observations.frontal(FRONTAL), normals, laplacian, reach, still, self._shot.threads
        )
        return normals, explained

    def lighting(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        return None

    def environment(self, vertices: np.ndarray, faces: np.ndarray) -> FittedEnvironmentMap:
        return fit_mirrored_environment(
            *self._shot.read(*coarser(vertices, faces, ENVIRONMENT_EDGE * self._shot.pixel))
        )


def fit_mirrored_environment(observations: Observations, normals: np.ndarray) -> FittedEnvironmentMap:
    """Fit the environment map that points with normals [P,3] mirror, from their readings under FRONTAL's tilt alone."""
    return fit_environment_map(observations.frontal(FRONTAL), normals)


def _nearest(target: np.ndarray, vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return for each vertex [V,3] the nearest wanted vertex along the edges [E,2], by index [V].

    target [V] bool. A vertex from which no path leads to a wanted one gets its own index.
    """
    own = np.arange(len(vertices))
    if not target.any():
        return own
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    ways = sparse.coo_matrix((lengths, edges.T), (len(vertices), len(vertices))).tocsr()
    sources = csgraph.dijkstra(
        ways, directed=False, indices=np.flatnonzero(target), min_only=True, return_predecessors=True
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
    sharp = (diffuse(bend[:, None], laplacian, 0.7)[:, 0] > CONVEX).astype(float)
    return np.clip(4 * diffuse(sharp[:, None], laplacian, max(reach, 0.7))[:, 0], 0, 1)
