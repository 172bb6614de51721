"""Light models of a flash and of an environment map, and the target normals that they give for a mesh."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import diffuse, mean_normals
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import AmbientOcclusion, estimate_occlusion
from mgsr.shading.environment_fit import FittedEnvironmentMap, fit_environment_map
from mgsr.shading.environment_normals import normals_from_environment
from mgsr.shading.flash import Flash, fit_albedo, normals_from_flash
from mgsr.shading.flash_fit import fit_flash
from mgsr.shading.lighting import Lighting, lamp_light
from mgsr.shading.observations import Observations
from mgsr.shading.photo_set import Observer
from mgsr.shading.pixel_footprint import deconvolve
from mgsr.shading.target_normals import TargetNormals

OCCLUSION_EDGE = 4.0  # pixels; edge length of the mesh for ambient occlusion
ENVIRONMENT_EDGE = 2.0  # pixels; edge length of the mesh for the fit of the environment map
IRRADIANCE_EDGE = 1.5  # pixels; edge length of the mesh that carries a flash's light
FINE = 1.25  # pixels; on meshes with shorter edges, observations are corrected for the pixels' footprints
BRIGHTEST = 0.995  # quantile of the irradiance that counts as the brightest light
FRONTAL = 0.5  # least cosine of the tilt; at grazing angles, reflection is stronger than one map can model (Fresnel)
POOL = 2.5  # pixels over which the costs of neighbours are pooled
CONVEX = 0.12  # radians per pixel; convex edges that bend more are kept, as pixels show too little of each side


class LightModel(Protocol):
    """A model of the light on a mesh, fitted to the photographs."""

    def explain(self, mesh: Mesh) -> TargetNormals:
        """Return the target normals of a mesh's vertices under this light."""

    def lighting(self, mesh: Mesh) -> Lighting | None:
        """Return the flash's light on a mesh; None for a static light."""

    def environment(self, mesh: Mesh) -> FittedEnvironmentMap | None:
        """Return the environment map that a mesh mirrors; None for a flash."""


class FlashLight:
    """A lamp that moves with the camera. Each call of `explain` refines its position on the refined mesh."""

    def __init__(self, observer: Observer, mesh: Mesh, observations: Observations) -> None:
        """Estimate the lamp from the observations of a mesh's vertices."""
        self._observer = observer
        self._cameras = [photograph.camera for photograph in observer.photographs]
        self._occlusion = self._estimate_occlusion(mesh)
        self._flash = fit_flash(
            observations, mesh.vertices, mesh.double_normals, self._cameras, self._occlusion, Flash()
        )

    def explain(self, mesh: Mesh) -> TargetNormals:
        observations = self._observer.observe(mesh, self._flash.lamps(self._cameras))
        seen, points = (self._cameras, self._occlusion), (mesh.vertices, mesh.double_normals)
        self._flash = fit_flash(observations, *points, *seen, self._flash)
        if mesh.edge_length < FINE * self._observer.pixel:
            observations = self._deconvolved(observations, mesh)
            self._flash = fit_flash(observations, *points, *seen, self._flash)
        return normals_from_flash(observations, *points, self._flash, *seen, self._observer.threads)

    def lighting(self, mesh: Mesh) -> Lighting:
        mesh = coarser(mesh, IRRADIANCE_EDGE * self._observer.pixel)
        lamps, occlusion = self._flash.lamps(self._cameras), self._estimate_occlusion(mesh)
        observations, points = self._observer.observe(mesh, lamps), mesh.vertices
        flash = fit_flash(observations, points, mesh.double_normals, self._cameras, occlusion, self._flash)
        sky_visibility, interreflection = occlusion.at(points, observations.photographs)
        # Interreflection varies little between photographs, so its mean over those that show the place is enough.
        seen = observations.weights > 0
        bounced = (interreflection * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        ambient = flash.ambient * sky_visibility + flash.bounced * bounced
        to_lamps = lamps[observations.photographs] - points[:, None]
        light = lamp_light(to_lamps, mesh.double_normals[:, None]) + ambient[:, None]
        most = float(np.quantile(light[seen], BRIGHTEST)) if seen.any() else 1.0
        proxy_vertex = _nearest(np.asarray(seen.any(axis=1)), mesh)
        return Lighting(mesh, ambient / most, proxy_vertex, flash.right, flash.down, 1 / most)

    def environment(self, mesh: Mesh) -> None:
        return None

    def _deconvolved(self, observations: Observations, mesh: Mesh) -> Observations:
        """Return the observations of a mesh's vertices, corrected for the footprints of pixels (`deconvolve`)."""
        flash, lamps, vertices, normals = (
            self._flash,
            self._flash.lamps(self._cameras),
            mesh.vertices,
            mesh.double_normals,
        )
        albedo = fit_albedo(observations, vertices, normals, flash, self._cameras, self._occlusion)
        albedo = albedo[_nearest(observations.counts > 0, mesh)]
        sky_visibility, interreflection = self._occlusion.at(
            vertices, np.broadcast_to(np.arange(len(lamps)), (len(vertices), len(lamps)))
        )
        gap = self._observer.pixel

        def shown(number: int, some: np.ndarray) -> np.ndarray:
            """Return the brightness [R] that the light model gives the vertices `some` [R] in a photograph."""
            places, facing, visible = vertices[some], normals[some], sky_visibility[some]
            lamp = lamp_light(lamps[number] - places, facing)
            shaded = np.flatnonzero(visible < 1)
            lamp[shaded] *= mesh.caster.reached(lamps[number], places[shaded] + gap * facing[shaded], gap)
            return np.asarray(
                albedo[some] * (lamp + flash.ambient * visible + flash.bounced * interreflection[some, number])
            )

        return deconvolve(observations, mesh, self._observer.photographs, shown, self._observer.threads)

    def _estimate_occlusion(self, mesh: Mesh) -> AmbientOcclusion:
        coarse = coarser(mesh, OCCLUSION_EDGE * self._observer.pixel)
        return estimate_occlusion(coarse, self._observer.photographs, self._observer.pixel, self._observer.threads)


class EnvironmentLight:
    """A static environment that the surface mirrors."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer

    def explain(self, mesh: Mesh) -> TargetNormals:
        observations, pixel = self._observer.observe(mesh), self._observer.pixel
        reach = POOL * pixel / mesh.edge_length
        still = _near_sharp_edges(mesh, pixel, reach)
        return normals_from_environment(
            observations.frontal(FRONTAL), mesh.double_normals, mesh.laplacian, reach, still, self._observer.threads
        )

    def lighting(self, mesh: Mesh) -> None:
        return None

    def environment(self, mesh: Mesh) -> FittedEnvironmentMap:
        coarse = coarser(mesh, ENVIRONMENT_EDGE * self._observer.pixel)
        return fit_mirrored_environment(self._observer.observe(coarse), coarse.double_normals)


def fit_mirrored_environment(observations: Observations, normals: np.ndarray) -> FittedEnvironmentMap:
    """Fit the environment map that points with unit normals [P,3] mirror.

    Only observations at a cosine of FRONTAL or more count.
    """
    return fit_environment_map(observations.frontal(FRONTAL), normals)


def _nearest(target: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Return the index [V] of each vertex's nearest target vertex along the edges.

    target [V] bool. A vertex without a path to a target gets its own index.
    """
    vertices, edges = mesh.vertices, mesh.edges
    own = np.arange(len(vertices))
    if not target.any():
        return own
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    ways = sparse.coo_matrix((lengths, edges.T), (len(vertices), len(vertices))).tocsr()
    sources = csgraph.dijkstra(
        ways, directed=False, indices=np.flatnonzero(target), min_only=True, return_predecessors=True
    )[2]
    return np.asarray(np.where(sources >= 0, sources, own))


def _near_sharp_edges(mesh: Mesh, pixel: float, reach: float) -> np.ndarray:
    """Return each vertex's nearness [V] to sharp convex edges: 1 beside an edge, 0 far from all.

    pixel: the size of a pixel, in the scene's unit. reach: the distance over which it falls, in edge lengths.
    """
    vertices, laplacian, normals = mesh.vertices, mesh.laplacian, mesh.double_normals
    steps = laplacian @ vertices
    length = np.sqrt(np.maximum((laplacian @ (vertices**2)).sum(1) - 2 * (vertices * steps).sum(1), 1e-20))
    smooth = mean_normals(normals, laplacian, rounds=1)
    bend = -(steps * smooth).sum(1) * 4 / length**2 * pixel
    sharp = (diffuse(bend[:, None], laplacian, 0.7)[:, 0] > CONVEX).astype(float)
    nearness: np.ndarray = np.clip(4 * diffuse(sharp[:, None], laplacian, max(reach, 0.7))[:, 0], 0, 1)
    return nearness
