"""Photometric multi-view refinement: a surface is moved to where the photographs agree on what lies on it.

Where a mesh lies before or behind the true surface, each photograph shows another place of it under the same vertex.
Fine texture and creases tell by how much; what is coarser comes from the light, whose shades and highlights have a
parallax of their own, and is left out. This is Lucas and Kanade's (1981) registration with one displacement a vertex,
along its normal, under a thin plate: variational stereo, as in Faugeras and Keriven (1998) and Vu and others (2012).

Where the light stands still, what gloss mirrors moves all the same; where the environment map is known, a reading
counts less the more of the detail around it is mirrored. And contours must hold the surface: parallax alone draws it
inwards, by 3 per mille of its radius from the very truth of a painted cow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mgsr.data.camera import pixel_size
from mgsr.data.scene import View, some_of
from mgsr.geometry.contours import SilhouetteContour, contour_gaps
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, smooth_displacements, uniform_laplacian
from mgsr.geometry.raycast import prolongation_matrix
from mgsr.shading.details import Details, KnownLight, Surface, centered, choose_mix, mix_channels, read_details
from mgsr.shading.light_models import LightModel

EDGE = 1.5  # pixels; edges of the mesh at whose vertices the photographs are read
COARSE = 4.0  # pixels; edges of the mesh on which displacements are found, as they are smooth
ROUNDS = 3  # of reading the photographs and moving the vertices
LIMIT = 1.0  # pixels that a vertex moves in a round at most
NOISE = 3.0  # pixels over which what a displacement can't explain is averaged
OUTLIER = 3.0  # deviations at which a reading counts half
MIXED = 16  # photographs, at most, by which the mix of the channels is chosen
MIRRORED = 0.25  # deviations of the noise; where what is mirrored varies by this, a reading counts half
KNOWN = 0.3  # pixels; a displacement known to this has weight 1 in the thin plate
OUTLINE = 0.1  # pixels to which a mask's outline is known
STAY = 1e-4  # weight of a vertex's own place, for those of which nothing tells


def refine_photometrically(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[View],
    contours: Sequence[SilhouetteContour],
    reach: float,
    light_model: LightModel | None = None,
    threads: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> np.ndarray:
    """Return the vertices [V,3] of a mesh moved along their normals so that the photographs agree at them.

    contours: the masks' contours, which hold the surface. reach: pixels over which a displacement spreads that is known
    to KNOWN. light_model: what light the photographs were taken in, if that is known. go_on: asked before every round;
    once it says no, no more rounds follow.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    light = KnownLight.known_by(light_model, vertices, faces)
    start, triangles = coarser(vertices, faces, EDGE * pixel)
    laplacian, places = uniform_laplacian(triangles, len(start)), start
    mix = choose_mix(Surface(start, triangles, laplacian, pixel), some_of(views, MIXED), light, threads)
    photographs = mix_channels(some_of(views), mix, threads)
    plate = _plate(start, *coarser(start, triangles, COARSE * pixel), reach * pixel)
    for _ in range(ROUNDS):
        if not go_on():
            break
        surface = Surface(places, triangles, laplacian, pixel)
        observations = read_details(surface, photographs, light, threads)
        target, weights = _told(observations, surface)
        gaps, touched = contour_gaps(places, triangles, surface.normals, contours)
        held = np.minimum(touched, 1) * (KNOWN / OUTLINE) ** 2
        total = weights + held + STAY
        moves = plate((weights * target + held * gaps / pixel) / total, total)
        places = places + pixel * np.clip(moves, -LIMIT, LIMIT)[:, None] * surface.normals
    return vertices + prolongation_matrix(start, triangles, vertices) @ (places - start)


def _plate(
    points: np.ndarray, coarse: np.ndarray, triangles: np.ndarray, reach: float
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that smooths displacements of points [P,3] by a thin plate on a coarse mesh beside them.

    It takes the points' target displacements [P] and their weights [P], and returns displacements [P].
    """
    prolongation, laplacian = prolongation_matrix(coarse, triangles, points), uniform_laplacian(triangles, len(coarse))
    steps = reach / edge_length(coarse, triangles) * (len(points) / len(coarse)) ** 0.25
    return lambda target, weights: prolongation @ smooth_displacements(laplacian, target, weights, steps, prolongation)


def _told(observations: Details, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements [V], in pixels, after which the photographs agree best, and their weights [V]."""
    weights = observations.weights
    noise = _noise(centered(observations.mixed, weights), weights)
    weights = weights / (1 + (observations.mirrored / (MIRRORED * noise)) ** 2)
    irls_weights = weights
    for _ in range(2):
        residual = centered(observations.mixed, irls_weights)
        noise = _noise(residual, weights)
        irls_weights = weights / (1 + (residual / (OUTLIER * noise)) ** 2)
    residual, slope = centered(observations.mixed, irls_weights), centered(observations.change, irls_weights)
    residual_energy = (weights * np.minimum(residual**2, (10 * noise) ** 2)).sum(axis=1)
    around = surface.around(np.stack([residual_energy, weights.sum(axis=1)], axis=1), NOISE)
    variance = np.maximum(around[:, 0] / np.maximum(around[:, 1], 1e-9), noise**2 / 4)
    steepness = (irls_weights * slope**2).sum(axis=1)
    target = -(irls_weights * slope * residual).sum(axis=1) / np.maximum(steepness, 1e-12)
    return target, KNOWN**2 * steepness / variance


def _noise(residual: np.ndarray, weights: np.ndarray) -> float:
    """Return the robust deviation of the residuals [V,K] where the weights [V,K] are above 0.

    It is the median absolute residual times 1.4826; 1 where no weight is above 0.
    """
    return 1.4826 * float(np.median(np.abs(residual[weights > 0]))) + 1e-9 if weights.any() else 1.0
