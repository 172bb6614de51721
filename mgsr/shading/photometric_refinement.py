"""Photometric multi-view refinement: a surface is moved to where it is photo-consistent.

Where a mesh lies before or behind the true surface, the photographs show different places at the same vertex. Fine
texture and creases determine the displacement. Coarser variation is left out, because it includes shading and
highlights, which move differently between views.

The method is variational stereo, as in Faugeras and Keriven (1998) and Vu and others (2012). It registers photographs
as Lucas and Kanade (1981) do, with one displacement for each vertex, along its normal, under a thin-plate prior.

Reflections move across the surface even under static light. If the environment map is known, an observation weighs less
where the mirrored detail around it is stronger. The silhouette contours must hold the surface, because parallax alone
pulls it slightly inwards.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mgsr.config.expert import PhotometricOptions
from mgsr.data.robust import robust_deviation
from mgsr.data.scene import some_of
from mgsr.geometry.contours import contour_gaps
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import smooth_displacements
from mgsr.geometry.mesh import Mesh
from mgsr.shading.details import Details, KnownLight, ObservedMesh, centered, choose_mix, mix_channels, read_details
from mgsr.shading.light_models import LightModel
from mgsr.shading.photo_set import PhotoSet

REWEIGHTINGS = 2  # of the observations in a round
GROSS = 10.0  # deviations of the noise; larger residuals count as this large in the variance
LEAST_VARIANCE = 0.25  # of an observation, in variances of the noise


def refine_photometrically(
    mesh: Mesh,
    photos: PhotoSet,
    reach: float,
    light_model: LightModel | None = None,
    go_on: Callable[[], bool] = lambda: True,
    options: PhotometricOptions = PhotometricOptions(),
) -> Mesh:
    """Move a mesh's vertices along their normals to photo-consistent positions.

    photos: the photographs; their silhouette contours hold the surface. reach: the distance, in pixels, over which a
    displacement with a deviation of `options.precision` spreads. light_model: the light of the photographs; None:
    unknown. go_on: called before every round; the refinement ends once it returns False.
    """
    pixel = photos.pixel_on(mesh)
    light = KnownLight.known_by(light_model, mesh)
    start = coarser(mesh, options.edge * pixel, options.max_faces)
    few = some_of(photos.photographs, options.mix_views)
    mix = choose_mix(ObservedMesh(start, pixel, options.details), few, light, photos.threads)
    mixes = mix_channels(some_of(photos.photographs), mix, photos.threads, options.details)
    coarse = coarser(start, options.coarse_edge * pixel, options.max_faces)
    precision = options.inexact_contour_precision if photos.masks_inexact else options.contour_precision
    plate = _plate(start.vertices, coarse, reach * pixel)
    moved = start
    for _ in range(options.rounds):
        if not go_on():
            break
        surface = ObservedMesh(moved, pixel, options.details)
        target, weights = _registered(read_details(surface, mixes, light, photos.threads), surface, options)
        gaps, touched = contour_gaps(moved.with_normals(moved.double_normals), photos.contours, options.contours)
        held = np.minimum(touched, 1) * (options.precision / precision) ** 2
        total = weights + held + options.prior_weight
        moves = np.clip(plate((weights * target + held * gaps / pixel) / total, total), -options.limit, options.limit)
        moved = moved.moved(moved.vertices + pixel * moves[:, None] * moved.double_normals)
    return mesh.moved(mesh.vertices + start.prolongation(mesh.vertices) @ (moved.vertices - start.vertices))


def _plate(points: np.ndarray, coarse: Mesh, reach: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that smooths displacements of points [P,3] by a thin plate on a coarse mesh near them.

    The function takes the points' target displacements [P] and weights [P], and returns displacements [P].
    """
    prolongation = coarse.prolongation(points)
    steps = reach / coarse.edge_length * (len(points) / len(coarse.vertices)) ** 0.25
    return lambda target, weights: (
        prolongation @ smooth_displacements(coarse.laplacian, target, weights, steps, prolongation)
    )


def _registered(details: Details, surface: ObservedMesh, options: PhotometricOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the most photo-consistent displacements [V], in pixels, and their weights [V]."""
    weights = details.weights
    noise = _noise(centered(details.mixed, weights), weights)
    weights = weights / (1 + (details.mirrored / (options.mirrored * noise)) ** 2)
    irls_weights = weights
    for _ in range(REWEIGHTINGS):
        residual = centered(details.mixed, irls_weights)
        noise = _noise(residual, weights)
        irls_weights = weights / (1 + (residual / (options.outlier * noise)) ** 2)
    residual, slope = centered(details.mixed, irls_weights), centered(details.change, irls_weights)
    residual_energy = (weights * np.minimum(residual**2, (GROSS * noise) ** 2)).sum(axis=1)
    around = surface.around(np.stack([residual_energy, weights.sum(axis=1)], axis=1), options.noise_reach)
    variance = np.maximum(around[:, 0] / np.maximum(around[:, 1], 1e-9), noise**2 * LEAST_VARIANCE)
    steepness = (irls_weights * slope**2).sum(axis=1)
    target = -(irls_weights * slope * residual).sum(axis=1) / np.maximum(steepness, 1e-12)
    return target, options.precision**2 * steepness / variance


def _noise(residual: np.ndarray, weights: np.ndarray) -> float:
    """Return the robust standard deviation of the residuals [V,K] with positive weights [V,K].

    It is `robust_deviation`, or 1 if no weight is positive.
    """
    return robust_deviation(residual[weights > 0]) + 1e-9 if weights.any() else 1.0
