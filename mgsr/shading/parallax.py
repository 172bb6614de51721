"""A surface moved to where the photographs agree on what lies on it.

Where a mesh lies before or behind the true surface, each photograph shows another place of it under the same vertex.
Fine texture and creases tell by how much; what is coarser comes from the light, whose shades and highlights have a
parallax of their own, and is left out. This is Lucas and Kanade's (1981) registration with one displacement a vertex,
along its normal, under a thin plate: variational stereo, as in Faugeras and Keriven (1998) and Vu and others (2012).

It needs light that stands still: under a flash on the camera, what is fine moves as well. So does what gloss mirrors:
where the surroundings are known, a reading counts less the more of its detail is mirrored. And it needs outlines to
hold the surface: parallax alone draws it inwards, by 3 per mille of its radius from the very truth of a painted cow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.images import srgb_rate
from mgsr.data.scene import View
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import edge_length, smooth_displacements, spread, umbrella
from mgsr.geometry.outlines import Outline, outline_gaps
from mgsr.geometry.raycast import RayCaster, interpolation
from mgsr.geometry.triangles import vertex_normals
from mgsr.parallel import map_ahead
from mgsr.shading.readings import CLIPPED, SOLID, read_image, seen_frontal, some_of
from mgsr.shading.surroundings import Surroundings

EDGE = 1.5  # pixels; edges of the mesh at whose vertices the photographs are read
COARSE = 4.0  # pixels; edges of the mesh on which displacements are found, as they are smooth
ROUNDS = 3  # of reading the photographs and moving the vertices
LIMIT = 1.0  # pixels that a vertex moves in a round at most
BLUR = 1.0  # pixels; of the photographs, against their noise
DETAIL = 3.0  # pixels; of a wider blur, which is taken off: what is coarser is the light's
NOISE = 3.0  # pixels over which what a displacement can't explain is averaged
MIN_COS = 0.3  # of the tilt; what is seen more grazing is left out
MIN_READINGS = 4  # photographs that see a vertex, or they tell nothing of it
OUTLIER = 3.0  # deviations at which a reading counts half
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
    surroundings: Surroundings | None = None,
    threads: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> np.ndarray:
    """The vertices [V,3] of a mesh moved along their normals so that the photographs agree at them.

    outlines: the masks', which hold the surface. reach: pixels over which a displacement spreads that is known to
    KNOWN. surroundings: what the surface mirrors, if that is known: where it is detailed, the photographs tell less.
    go_on: asked before every round; the surface stays as it is then once it says no.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    photographs = list(map_ahead(_photograph, some_of(views), threads))
    start, triangles = coarser(vertices, faces, EDGE * pixel)
    edge = edge_length(start, triangles) / pixel
    plate = _plate(start, *coarser(start, triangles, COARSE * pixel), reach * pixel)
    laplacian, places = umbrella(triangles, len(start)), start
    for _ in range(ROUNDS):
        if not go_on():
            break
        normals = vertex_normals(places, triangles).astype(np.float64)
        readings = _read(places, triangles, normals, photographs, pixel, threads)
        mirrored = _mirrored(surroundings, places, normals, photographs, laplacian, edge) * readings.rate
        wanted, weights = _told(readings, mirrored, laplacian, edge)
        gaps, touched = outline_gaps(places, triangles, normals, outlines)
        held = np.minimum(touched, 1) * (KNOWN / OUTLINE) ** 2
        total = weights + held + STAY
        moves = plate((weights * wanted + held * gaps / pixel) / total, total)
        places = places + pixel * np.clip(moves, -LIMIT, LIMIT)[:, None] * normals
    return vertices + interpolation(start, triangles, vertices) @ (places - start)


def _plate(
    points: np.ndarray, coarse: np.ndarray, triangles: np.ndarray, reach: float
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The thin plate on a coarse mesh that joins what points [P,3] beside it want: displacements [P], weights [P]."""
    carry, laplacian = interpolation(coarse, triangles, points), umbrella(triangles, len(coarse))
    steps = reach / edge_length(coarse, triangles) * (len(points) / len(coarse)) ** 0.25
    return lambda wanted, weights: carry @ smooth_displacements(laplacian, wanted, weights, steps, carry)


@dataclass(frozen=True)
class _Photograph:
    """brightness, less that around it; across and down, how that changes a pixel on; rate, how brightness changes with
    linear light; usable, 1 where it is of use, else 0: all [H,W] float32."""

    camera: Camera
    brightness: np.ndarray
    across: np.ndarray
    down: np.ndarray
    rate: np.ndarray
    usable: np.ndarray


def _photograph(view: View) -> _Photograph:
    """The detail of the mean of the channels, in sRGB, whose noise is more even than linear light's."""
    srgb = view.image.astype(np.float32) / 255
    inside = srgb.max(axis=-1) <= CLIPPED
    if view.alpha is not None:
        inside &= view.alpha >= SOLID * 255
    if view.known is not None:
        inside &= view.known
    fine, coarse = (_blurred(srgb.mean(axis=-1), inside, width) for width in (BLUR, DETAIL))
    brightness = fine - coarse
    down, across = np.gradient(brightness)
    usable = ndimage.binary_erosion(inside, iterations=round(2 * BLUR)).astype(np.float32)
    return _Photograph(view.camera, brightness, across, down, srgb_rate(srgb.mean(axis=-1)), usable)


def _blurred(image: np.ndarray, inside: np.ndarray, width: float) -> np.ndarray:
    """The image [H,W] blurred by `width` pixels, without what lies outside [H,W]."""
    share = ndimage.gaussian_filter(inside.astype(np.float32), width)
    return ndimage.gaussian_filter(image * inside, width) / np.maximum(share, 1e-6)


@dataclass(frozen=True)
class _Readings:
    """V vertices in K photographs, each [V,K] float32: brightness; change, of it for each pixel's size that the vertex
    moves along its normal; rate, how it changes with linear light; weights, the cosine of the tilt where the vertex is
    seen, else 0."""

    brightness: np.ndarray
    change: np.ndarray
    rate: np.ndarray
    weights: np.ndarray


def _read(
    places: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    photographs: Sequence[_Photograph],
    pixel: float,
    threads: int | None,
) -> _Readings:
    caster = RayCaster(places, triangles)
    rows = map_ahead(lambda each: _read_one(caster, each, places, normals, pixel), photographs, threads)
    brightness, change, rate, weights = (np.stack(columns, axis=1) for columns in zip(*rows, strict=True))
    weights[(weights > 0).sum(axis=1) < MIN_READINGS] = 0
    return _Readings(brightness, change, rate, weights)


def _read_one(
    caster: RayCaster, photograph: _Photograph, places: np.ndarray, normals: np.ndarray, pixel: float
) -> np.ndarray:
    """A photograph's column of the readings' four, [4,V]."""
    camera, column = photograph.camera, np.zeros((4, len(places)), np.float32)
    offsets = camera.center - places
    cosines = (offsets * normals).sum(axis=1) / np.linalg.norm(offsets, axis=1)
    seen = seen_frontal(caster, camera, places, normals, cosines > MIN_COS, pixel)
    pixels, _ = camera.project(places[seen])
    moved, _ = camera.project(places[seen] + 0.1 * pixel * normals[seen])
    step = 10 * (moved - pixels)
    across, down = read_image(photograph.across, pixels), read_image(photograph.down, pixels)
    column[0, seen] = read_image(photograph.brightness, pixels)
    column[1, seen] = across * step[:, 0] + down * step[:, 1]
    column[2, seen] = read_image(photograph.rate, pixels)
    column[3, seen] = cosines[seen] * (read_image(photograph.usable, pixels) > 0.99)
    return column


def _mirrored(
    surroundings: Surroundings | None,
    places: np.ndarray,
    normals: np.ndarray,
    photographs: Sequence[_Photograph],
    laplacian: sparse.csr_matrix,
    edge: float,
) -> np.ndarray:
    """The detail [V,K] of what the surface mirrors in the photographs, in linear light."""
    light = np.zeros((len(places), len(photographs)), np.float32)
    if surroundings is None:
        return light
    for column, photograph in zip(light.T, photographs, strict=True):
        offsets = photograph.camera.center - places
        column[:] = surroundings.mirrored(normals, offsets / np.linalg.norm(offsets, axis=1, keepdims=True))
    return light - spread(light, laplacian, DETAIL / edge)


def _told(
    readings: _Readings, mirrored: np.ndarray, laplacian: sparse.csr_matrix, edge: float
) -> tuple[np.ndarray, np.ndarray]:
    """The displacements [V], in pixels, after which the photographs agree best, and what each weighs [V].

    mirrored [V,K]: how much of the brightness is mirrored. edge: the mesh's, in pixels."""
    weights = readings.weights
    noise = _noise(_apart(readings.brightness, weights), weights)
    weights = weights / (1 + (mirrored / (MIRRORED * noise)) ** 2)
    trusted = weights
    for _ in range(2):
        left = _apart(readings.brightness, trusted)
        noise = _noise(left, weights)
        trusted = weights / (1 + (left / (OUTLIER * noise)) ** 2)
    left, slope = _apart(readings.brightness, trusted), _apart(readings.change, trusted)
    unexplained = (weights * np.minimum(left**2, (10 * noise) ** 2)).sum(axis=1)
    around = spread(np.stack([unexplained, weights.sum(axis=1)], axis=1), laplacian, NOISE / edge)
    variance = np.maximum(around[:, 0] / np.maximum(around[:, 1], 1e-9), noise**2 / 4)
    steepness = (trusted * slope**2).sum(axis=1)
    wanted = -(trusted * slope * left).sum(axis=1) / np.maximum(steepness, 1e-12)
    return wanted, KNOWN**2 * steepness / variance


def _noise(left: np.ndarray, weights: np.ndarray) -> float:
    """The deviation of what is left unexplained [V,K] where the weights [V,K] are above 0, but for outliers."""
    return 1.4826 * float(np.median(np.abs(left[weights > 0]))) + 1e-9 if weights.any() else 1.0


def _apart(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Values [V,K] less their mean over the photographs by weights [V,K]."""
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    return values - (weights * values).sum(axis=1, keepdims=True) / total
