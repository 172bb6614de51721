"""Photometric multi-view refinement: a surface is moved to where the photographs agree on what lies on it.

Where a mesh lies before or behind the true surface, each photograph shows another place of it under the same vertex.
Fine texture and creases tell by how much; what is coarser comes from the light, whose shades and highlights have a
parallax of their own, and is left out. This is Lucas and Kanade's (1981) registration with one displacement a vertex,
along its normal, under a thin plate: variational stereo, as in Faugeras and Keriven (1998) and Vu and others (2012).

Where the light stands still, what gloss mirrors moves all the same; where the environment map is known, an observation
counts less the more of the detail around it is mirrored. And contours must hold the surface: parallax alone draws it
inwards, by 3 per mille of its radius from the very truth of a painted cow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mgsr.data.scene import some_of
from mgsr.geometry.contours import contour_gaps
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import smooth_displacements
from mgsr.geometry.mesh import Mesh
from mgsr.shading.details import Details, KnownLight, ObservedMesh, centered, choose_mix, mix_channels, read_details
from mgsr.shading.light_models import LightModel
from mgsr.shading.photo_set import PhotoSet


@dataclass(frozen=True)
class PhotometricOptions:
    """Numbers of the photometric refinement; pixels are those of the photographs on the surface."""

    edge: float = 1.5  # pixels; edges of the mesh at whose vertices the photographs are read
    coarse_edge: float = 4.0  # pixels; edges of the mesh on which displacements are found, as they are smooth
    rounds: int = 3  # of reading the photographs and moving the vertices
    limit: float = 1.0  # pixels that a vertex moves in a round at most
    noise_reach: float = 3.0  # pixels over which what a displacement cannot explain is averaged
    outlier: float = 3.0  # deviations at which an observation counts half
    mix_views: int = 16  # photographs, at most, by which the mix of the channels is chosen
    mirrored: float = 0.25  # deviations of the noise; where mirrored detail varies by this, an observation counts half
    precision: float = 0.3  # pixels; a displacement known to this has weight 1 in the thin plate
    contour_precision: float = 0.1  # pixels to which a mask's contour is known
    prior_weight: float = 1e-4  # of a vertex's own place, for those of which nothing tells


def refine_photometrically(
    mesh: Mesh,
    photos: PhotoSet,
    reach: float,
    light_model: LightModel | None = None,
    go_on: Callable[[], bool] = lambda: True,
    options: PhotometricOptions = PhotometricOptions(),
) -> Mesh:
    """Return the mesh with its vertices moved along their normals so that the photographs agree at them.

    photos: their silhouette contours hold the surface. reach: pixels over which a displacement spreads that is known to
    `options.precision`. light_model: the light of the photographs, if that is known. go_on: asked before every round;
    once it says no, no more rounds follow.
    """
    pixel = photos.pixel_on(mesh)
    light = KnownLight.known_by(light_model, mesh)
    start = coarser(mesh, options.edge * pixel)
    few = some_of(photos.views, options.mix_views)
    mix = choose_mix(ObservedMesh(start, pixel), few, light, photos.threads)
    photographs = mix_channels(some_of(photos.views), mix, photos.threads)
    plate = _plate(start.vertices, coarser(start, options.coarse_edge * pixel), reach * pixel)
    moved = start
    for _ in range(options.rounds):
        if not go_on():
            break
        surface = ObservedMesh(moved, pixel)
        target, weights = _registered(read_details(surface, photographs, light, photos.threads), surface, options)
        gaps, touched = contour_gaps(moved.with_normals(moved.double_normals), photos.contours)
        held = np.minimum(touched, 1) * (options.precision / options.contour_precision) ** 2
        total = weights + held + options.prior_weight
        moves = np.clip(plate((weights * target + held * gaps / pixel) / total, total), -options.limit, options.limit)
        moved = moved.moved(moved.vertices + pixel * moves[:, None] * moved.double_normals)
    return mesh.moved(mesh.vertices + start.prolongation(mesh.vertices) @ (moved.vertices - start.vertices))


def _plate(points: np.ndarray, coarse: Mesh, reach: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that smooths displacements of points [P,3] by a thin plate on a coarse mesh beside them.

    It takes the points' target displacements [P] and their weights [P], and returns displacements [P].
    """
    prolongation = coarse.prolongation(points)
    steps = reach / coarse.edge_length * (len(points) / len(coarse.vertices)) ** 0.25
    return lambda target, weights: (
        prolongation @ smooth_displacements(coarse.laplacian, target, weights, steps, prolongation)
    )


def _registered(details: Details, surface: ObservedMesh, options: PhotometricOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements [V], in pixels, after which the photographs agree best, and their weights [V]."""
    weights = details.weights
    noise = _noise(centered(details.mixed, weights), weights)
    weights = weights / (1 + (details.mirrored / (options.mirrored * noise)) ** 2)
    irls_weights = weights
    for _ in range(2):
        residual = centered(details.mixed, irls_weights)
        noise = _noise(residual, weights)
        irls_weights = weights / (1 + (residual / (options.outlier * noise)) ** 2)
    residual, slope = centered(details.mixed, irls_weights), centered(details.change, irls_weights)
    residual_energy = (weights * np.minimum(residual**2, (10 * noise) ** 2)).sum(axis=1)
    around = surface.around(np.stack([residual_energy, weights.sum(axis=1)], axis=1), options.noise_reach)
    variance = np.maximum(around[:, 0] / np.maximum(around[:, 1], 1e-9), noise**2 / 4)
    steepness = (irls_weights * slope**2).sum(axis=1)
    target = -(irls_weights * slope * residual).sum(axis=1) / np.maximum(steepness, 1e-12)
    return target, options.precision**2 * steepness / variance


def _noise(residual: np.ndarray, weights: np.ndarray) -> float:
    """Return the robust deviation of the residuals [V,K] where the weights [V,K] are above 0.

    It is the median absolute residual times 1.4826; 1 where no weight is above 0.
    """
    return 1.4826 * float(np.median(np.abs(residual[weights > 0]))) + 1e-9 if weights.any() else 1.0
