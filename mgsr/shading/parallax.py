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
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, smooth_displacements, umbrella
from mgsr.geometry.outlines import Outline, outline_gaps
from mgsr.geometry.raycast import interpolation
from mgsr.shading.details import Details, KnownLight, Surface, apart, mixed_photographs, read_details, telling_mix
from mgsr.shading.kinds import Shading

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


def refine_by_parallax(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[View],
    outlines: Sequence[Outline],
    reach: float,
    shading: Shading | None = None,
    threads: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> np.ndarray:
    """Return the vertices [V,3] of a mesh moved along their normals so that the photographs agree at them.

    outlines: the masks' contours, which hold the surface. reach: pixels over which a displacement spreads that is known
    to KNOWN. shading: what light the photographs were taken in, if that is known. go_on: asked before every round; once
    it says no, no more rounds follow.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    light = KnownLight.known_by(shading, vertices, faces)
    start, triangles = coarser(vertices, faces, EDGE * pixel)
    laplacian, places = umbrella(triangles, len(start)), start
    mix = telling_mix(Surface(start, triangles, laplacian, pixel), some_of(views, MIXED), light, threads)
    photographs = mixed_photographs(some_of(views), mix, threads)
    plate = _plate(start, *coarser(start, triangles, COARSE * pixel), reach * pixel)
    for _ in range(ROUNDS):
        if not go_on():
            break
        surface = Surface(places, triangles, laplacian, pixel)
        readings = read_details(surface, photographs, light, threads)
        wanted, weights = _told(readings, surface)
        gaps, touched = outline_gaps(places, triangles, surface.normals, outlines)
        held = np.minimum(touched, 1) * (KNOWN / OUTLINE) ** 2
        total = weights + held + STAY
        moves = plate((weights * wanted + held * gaps / pixel) / total, total)
        places = places + pixel * np.clip(moves, -LIMIT, LIMIT)[:, None] * surface.normals
    moved: np.ndarray = vertices + interpolation(start, triangles, vertices) @ (places - start)
    return moved


def _plate(
    points: np.ndarray, coarse: np.ndarray, triangles: np.ndarray, reach: float
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function that smooths displacements of points [P,3] by a thin plate on a coarse mesh beside them.

    It takes the points' target displacements [P] and their weights [P], and returns displacements [P].
    """
    carry, laplacian = interpolation(coarse, triangles, points), umbrella(triangles, len(coarse))
    steps = reach / edge_length(coarse, triangles) * (len(points) / len(coarse)) ** 0.25
    return lambda wanted, weights: carry @ smooth_displacements(laplacian, wanted, weights, steps, carry)


def _told(readings: Details, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements [V], in pixels, after which the photographs agree best, and their weights [V]."""
    weights = readings.weights
    noise = _noise(apart(readings.mixed, weights), weights)
    weights = weights / (1 + (readings.mirrored / (MIRRORED * noise)) ** 2)
    trusted = weights
    for _ in range(2):
        left = apart(readings.mixed, trusted)
        noise = _noise(left, weights)
        trusted = weights / (1 + (left / (OUTLIER * noise)) ** 2)
    left, slope = apart(readings.mixed, trusted), apart(readings.change, trusted)
    unexplained = (weights * np.minimum(left**2, (10 * noise) ** 2)).sum(axis=1)
    around = surface.around(np.stack([unexplained, weights.sum(axis=1)], axis=1), NOISE)
    variance = np.maximum(around[:, 0] / np.maximum(around[:, 1], 1e-9), noise**2 / 4)
    steepness = (trusted * slope**2).sum(axis=1)
    wanted = -(trusted * slope * left).sum(axis=1) / np.maximum(steepness, 1e-12)
    return wanted, KNOWN**2 * steepness / variance


def _noise(left: np.ndarray, weights: np.ndarray) -> float:
    """Return the robust deviation of the residuals [V,K] where the weights [V,K] are above 0.

    It is the median absolute residual times 1.4826; 1 where no weight is above 0.
    """
    return 1.4826 * float(np.median(np.abs(left[weights > 0]))) + 1e-9 if weights.any() else 1.0
