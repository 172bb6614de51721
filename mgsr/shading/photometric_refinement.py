"""Photometric multi-view refinement: a surface is moved to where it is photo-consistent.

Where a mesh lies before or behind the true surface, the photographs show different places at the same vertex. Fine
texture and creases determine the displacement. Coarser variation is left out, because it includes shading and
highlights, which move differently between views.

The method is variational stereo, as in Faugeras and Keriven (1998) and Vu and others (2012). It registers photographs
as Lucas and Kanade (1981) do, with one displacement for each vertex, along its normal, under a thin-plate prior.

Each half of the photographs gives displacements of its own. Noise differs between the halves, and displacements shrink
where they do. So the surface converges, and noise does not add up over the steps.

A surface from stereo may err by many pixels. The prior then holds each step's displacement alone, so that all steps
together may go far. A trained surface mostly errs by less than a pixel. The prior and the comparison of the halves then
hold the displacements of all steps together. Errors that the halves share, such as those of the cameras, roughen it
less.

Reflections move across the surface even under static light, and both halves show them. If the environment map is known,
an observation weighs less where the mirrored detail around it is stronger, and the surface moves in fewer steps. The
silhouette contours must hold the surface, because parallax alone pulls it slightly inwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config.expert import PhotometricOptions
from mgsr.data.robust import robust_deviation
from mgsr.data.scene import some_of
from mgsr.geometry.contours import contour_gaps
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import smooth_displacements
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead
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
    accurate: bool = False,
) -> Mesh:
    """Move a mesh's vertices along their normals to photo-consistent positions.

    photos: the photographs; their silhouette contours hold the surface. reach: the distance, in pixels, over which a
    displacement with a deviation of `options.precision` spreads. light_model: the light of the photographs; None:
    unknown. go_on: called before every round; the refinement ends once it returns False. accurate: whether the mesh
    mostly errs by less than a pixel, so that the prior holds the displacements of all steps together.
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
    moved, total = start, np.zeros(len(start.vertices))
    for steps in _steps(options, light, accurate):
        if not go_on():
            break
        surface = ObservedMesh(moved, pixel, options.details)
        details = read_details(surface, mixes, light, photos.threads)
        gaps, touched = contour_gaps(moved.with_normals(moved.double_normals), photos.contours, options.contours)
        hold = _Hold(gaps / pixel, np.minimum(touched, 1) * (options.precision / precision) ** 2)
        move = np.zeros(len(moved.vertices))
        for _ in range(steps):
            held = total + move if accurate else np.zeros_like(move)
            move += _step(details.after(move), surface, hold.after(move), held, plate, options, photos.threads)
        move = np.clip(move, -options.limit, options.limit)
        moved, total = moved.moved(moved.vertices + pixel * move[:, None] * moved.double_normals), total + move
    return mesh.moved(mesh.vertices + start.prolongation(mesh.vertices) @ (moved.vertices - start.vertices))


def _steps(options: PhotometricOptions, light: KnownLight, accurate: bool) -> Sequence[int]:
    """Return the number of steps in each round."""
    if light.mirrors is not None:
        return [1] * options.mirrored_rounds
    return [options.steps] * (options.accurate_rounds if accurate else options.rounds)


def _plate(points: np.ndarray, coarse: Mesh, reach: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that smooths displacements of points [P,3] by a thin plate on a coarse mesh near them.

    The function takes the points' target displacements [P] and weights [P], and returns displacements [P].
    """
    prolongation = coarse.prolongation(points)
    steps = reach / coarse.edge_length * (len(points) / len(coarse.vertices)) ** 0.25
    return lambda target, weights: (
        prolongation @ smooth_displacements(coarse.laplacian, target, weights, steps, prolongation)
    )


@dataclass(frozen=True)
class _Hold:
    """The hold of the masks' contours on a mesh: displacements [V] towards them, in pixels, and their weights [V]."""

    target: np.ndarray
    weights: np.ndarray

    def after(self, move: np.ndarray) -> _Hold:
        """Return the hold after displacements [V], in pixels."""
        return replace(self, target=self.target - move)


def _step(
    details: Details,
    surface: ObservedMesh,
    hold: _Hold,
    held: np.ndarray,
    plate: Callable[[np.ndarray, np.ndarray], np.ndarray],
    options: PhotometricOptions,
    threads: int | None,
) -> np.ndarray:
    """Return displacements [V], in pixels, to where photographs and contours agree, as far as they are no noise.

    held [V]: earlier displacements, in pixels, that the prior holds together with this one. plate: as returned by
    `_plate`.
    """

    def moves(some: Details) -> np.ndarray:
        """Return the displacements [V], with those before, that some observations and the contours give."""
        target, weights = _registered(some, surface, options)
        sums = weights + hold.weights + options.prior_weight
        moved = plate((weights * (held + target) + hold.weights * (held + hold.target)) / sums, sums)
        return np.asarray(np.clip(moved, held - options.limit, held + options.limit))

    halves = [_half(details, first, options.min_in_half) for first in range(2)]
    known = np.all([half.weights.any(axis=1) for half in halves], axis=0)
    one, other, whole = map_ahead(moves, [*halves, details], threads)
    return np.asarray(_agreement(one, other, known, surface, options) * whole - held)


def _half(details: Details, first: int, least: int) -> Details:
    """Return the details with weights only for every second photograph, from the `first` on.

    A vertex that fewer than `least` of these show has no weights.
    """
    weights = np.zeros_like(details.weights)
    weights[:, first::2] = details.weights[:, first::2]
    weights[(weights > 0).sum(axis=1) < least] = 0
    return replace(details, weights=weights)


def _agreement(
    one: np.ndarray, other: np.ndarray, known: np.ndarray, surface: ObservedMesh, options: PhotometricOptions
) -> np.ndarray:
    """Return the share [V], 0..1, of the displacements from all photographs that is no noise.

    one, other [V]: the displacements from each half of the photographs. known [V] bool: where both halves observe the
    surface. Elsewhere, the share is that of the known vertices around, or 1 without any. Source: the reliability of two
    halves together, Spearman 1910 and Brown 1910.
    """
    products = np.stack([one * other, (one**2 + other**2) / 2], axis=1) * known[:, None]
    common, mean = surface.around(products, options.agreement_reach).T
    alike = np.clip(np.where(mean > 0, common / np.maximum(mean, 1e-12), 1), 0, 1)
    return np.asarray(2 * alike / (1 + alike))


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
