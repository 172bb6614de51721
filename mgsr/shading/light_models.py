"""Light models of a flash and of an environment map, and the target normals that they give for a mesh."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mgsr.config.expert import EnvironmentOptions, FlashOptions
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

BEND_REACH = 0.7  # edge lengths; least reach of averages of the bend
SHARPNESS = 4.0  # nearness to sharp edges, over the share of them around a vertex


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

    def __init__(
        self, observer: Observer, mesh: Mesh, observations: Observations, options: FlashOptions = FlashOptions()
    ) -> None:
        """Estimate the lamp from the observations of a mesh's vertices."""
        self._observer, self._options = observer, options
        self._cameras = [photograph.camera for photograph in observer.photographs]
        self._occlusion = self._estimate_occlusion(mesh)
        self._flash = fit_flash(
            observations, mesh.vertices, mesh.double_normals, self._cameras, self._occlusion, Flash(), options
        )

    def explain(self, mesh: Mesh) -> TargetNormals:
        observations = self._observer.observe(mesh, self._flash.lamps(self._cameras))
        seen, points = (self._cameras, self._occlusion), (mesh.vertices, mesh.double_normals)
        self._flash = fit_flash(observations, *points, *seen, self._flash, self._options)
        if mesh.edge_length < self._options.footprint_edge * self._observer.pixel:
            observations = self._deconvolved(observations, mesh)
            self._flash = fit_flash(observations, *points, *seen, self._flash, self._options)
        return normals_from_flash(
            observations, *points, self._flash, *seen, self._observer.photos.threads, self._options
        )

    def lighting(self, mesh: Mesh) -> Lighting:
        options = self._options.irradiance
        mesh = self._observer.coarser(mesh, options.edge, options.max_faces)
        lamps, occlusion = self._flash.lamps(self._cameras), self._estimate_occlusion(mesh)
        observations, points = self._observer.observe(mesh, lamps), mesh.vertices
        given = observations, points, mesh.double_normals, self._cameras, occlusion
        flash = fit_flash(*given, self._flash, self._options)
        sky_visibility, interreflection = occlusion.at(points, observations.photographs)
        # Interreflection varies little between photographs, so the mean over the photographs of a vertex suffices.
        seen = observations.weights > 0
        bounced = (interreflection * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        ambient = flash.ambient * sky_visibility + flash.bounced * bounced
        to_lamps = lamps[observations.photographs] - points[:, None]
        light = lamp_light(to_lamps, mesh.double_normals[:, None]) + ambient[:, None]
        most = float(np.quantile(light[seen], options.brightest)) if seen.any() else 1.0
        proxy_vertex = _nearest(np.asarray(seen.any(axis=1)), mesh)
        return Lighting(mesh, ambient / most, proxy_vertex, flash.right, flash.down, 1 / most, options)

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
        albedo = fit_albedo(observations, vertices, normals, flash, self._cameras, self._occlusion, self._options)
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

        rays = self._options.footprint_rays
        return deconvolve(observations, mesh, self._observer.photographs, shown, self._observer.photos.threads, rays)

    def _estimate_occlusion(self, mesh: Mesh) -> AmbientOcclusion:
        observer, options = self._observer, self._options.occlusion
        coarse = observer.coarser(mesh, options.edge, options.max_faces)
        return estimate_occlusion(coarse, observer.photographs, observer.pixel, observer.photos.threads, options)


class EnvironmentLight:
    """A static environment that the surface mirrors.

    known: a mesh, and the map that is fitted on it already.
    """

    def __init__(
        self,
        observer: Observer,
        options: EnvironmentOptions = EnvironmentOptions(),
        known: tuple[Mesh, FittedEnvironmentMap] | None = None,
    ) -> None:
        self._observer, self._options, self._known = observer, options, known

    def explain(self, mesh: Mesh) -> TargetNormals:
        options, pixel = self._options, self._observer.pixel
        observations = self._observer.observe(mesh).frontal(options.min_cosine)
        reach = options.normals.pooled * pixel / mesh.edge_length
        still = _near_sharp_edges(mesh, pixel, reach, options.normals.convex)
        return normals_from_environment(observations, mesh.double_normals, mesh.laplacian, reach, still, options)

    def lighting(self, mesh: Mesh) -> None:
        return None

    def environment(self, mesh: Mesh) -> FittedEnvironmentMap:
        if self._known is not None and mesh is self._known[0]:
            return self._known[1]
        coarse = self._observer.coarser(mesh, self._options.edge, self._options.max_faces)
        return fit_mirrored_environment(self._observer.observe(coarse), coarse.double_normals, self._options)


def fit_mirrored_environment(
    observations: Observations, normals: np.ndarray, options: EnvironmentOptions = EnvironmentOptions()
) -> FittedEnvironmentMap:
    """Fit the environment map that points with unit normals [P,3] mirror.

    Only observations at a cosine of `options.min_cosine` or more count.
    """
    return fit_environment_map(observations.frontal(options.min_cosine), normals, options=options.fit)


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


def _near_sharp_edges(mesh: Mesh, pixel: float, reach: float, convex: float) -> np.ndarray:
    """Return each vertex's nearness [V] to sharp convex edges: 1 beside an edge, 0 far from all.

    pixel: the size of a pixel, in the scene's unit. reach: the distance over which it falls, in edge lengths. convex:
    the bend, in radians per pixel, above which a convex edge is sharp.
    """
    vertices, laplacian, normals = mesh.vertices, mesh.laplacian, mesh.double_normals
    steps = laplacian @ vertices
    length = np.sqrt(np.maximum((laplacian @ (vertices**2)).sum(1) - 2 * (vertices * steps).sum(1), 1e-20))
    smooth = mean_normals(normals, laplacian, rounds=1)
    bend = -(steps * smooth).sum(1) * 4 / length**2 * pixel
    sharp = (diffuse(bend[:, None], laplacian, BEND_REACH)[:, 0] > convex).astype(float)
    nearness: np.ndarray = np.clip(SHARPNESS * diffuse(sharp[:, None], laplacian, max(reach, BEND_REACH))[:, 0], 0, 1)
    return nearness
