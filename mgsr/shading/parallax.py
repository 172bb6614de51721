"""A surface moved to where the photographs agree on what lies on it.

Where a mesh lies before or behind the true surface, each photograph shows another place of it under the same vertex.
Fine texture and creases tell by how much; what is coarser comes from the light, whose shades and highlights have a
parallax of their own, and is left out. This is Lucas and Kanade's (1981) registration with one displacement a vertex,
along its normal, under a thin plate: variational stereo, as in Faugeras and Keriven (1998) and Vu and others (2012).

Under a flash on the camera every photograph has a light of its own; where that is known, what a photograph shows of a
vertex is divided by the light on it. Where the light stands still, what gloss mirrors moves all the same; where the
surroundings are known, a reading counts less the more of its detail is mirrored. And outlines must hold the surface:
parallax alone draws it inwards, by 3 per mille of its radius from the very truth of a painted cow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

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
from mgsr.shading.kinds import Shading
from mgsr.shading.lighting import DIMMEST, GAMMA, Lighting
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
    shading: Shading | None = None,
    threads: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> np.ndarray:
    """The vertices [V,3] of a mesh moved along their normals so that the photographs agree at them.

    outlines: the masks', which hold the surface. reach: pixels over which a displacement spreads that is known to
    KNOWN. shading: what light the photographs were taken in, if that is known. go_on: asked before every round; the
    surface stays as it is then once it says no.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    photographs = list(map_ahead(_photograph, some_of(views), threads))
    light = _Light.known_by(shading, vertices, faces)
    start, triangles = coarser(vertices, faces, EDGE * pixel)
    laplacian, places = umbrella(triangles, len(start)), start
    plate = _plate(start, *coarser(start, triangles, COARSE * pixel), reach * pixel)
    for _ in range(ROUNDS):
        if not go_on():
            break
        surface = _Surface(places, triangles, laplacian, pixel)
        readings = _read(surface, photographs, light, threads)
        wanted, weights = _told(readings, surface)
        gaps, touched = outline_gaps(places, triangles, surface.normals, outlines)
        held = np.minimum(touched, 1) * (KNOWN / OUTLINE) ** 2
        total = weights + held + STAY
        moves = plate((weights * wanted + held * gaps / pixel) / total, total)
        places = places + pixel * np.clip(moves, -LIMIT, LIMIT)[:, None] * surface.normals
    return vertices + interpolation(start, triangles, vertices) @ (places - start)


def _plate(
    points: np.ndarray, coarse: np.ndarray, triangles: np.ndarray, reach: float
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The thin plate on a coarse mesh that joins what points [P,3] beside it want: displacements [P], weights [P]."""
    carry, laplacian = interpolation(coarse, triangles, points), umbrella(triangles, len(coarse))
    steps = reach / edge_length(coarse, triangles) * (len(points) / len(coarse)) ** 0.25
    return lambda wanted, weights: carry @ smooth_displacements(laplacian, wanted, weights, steps, carry)


@dataclass(frozen=True)
class _Light:
    """What is known of it: lighting, what a flash on the camera brings; mirrors, what surroundings gloss mirrors."""

    lighting: Lighting | None = None
    mirrors: Surroundings | None = None

    @classmethod
    def known_by(cls, shading: Shading | None, vertices: np.ndarray, faces: np.ndarray) -> _Light:
        if shading is None:
            return cls()
        return cls(shading.lighting(vertices, faces), shading.surroundings(vertices, faces))


@dataclass(frozen=True)
class _Surface:
    """A mesh on its way: places [V,3] of its vertices, faces [F,3], their `umbrella`, and a pixel's size there."""

    places: np.ndarray
    faces: np.ndarray
    laplacian: sparse.csr_matrix
    pixel: float

    @cached_property
    def normals(self) -> np.ndarray:
        return vertex_normals(self.places, self.faces).astype(np.float64)

    @cached_property
    def caster(self) -> RayCaster:
        return RayCaster(self.places, self.faces)

    def around(self, values: np.ndarray, reach: float) -> np.ndarray:
        """Values [V,...] averaged over about `reach` pixels around."""
        return spread(values, self.laplacian, reach * self.pixel / self._edge)

    def detail(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Values [N,V] less their mean around, where they are known [V] bool, else 0. All known ones count alike, so
        that photographs which see the same places take the same means."""
        around = self.around(np.stack([*(values * known), known], axis=1), DETAIL)
        return np.asarray(known * (values - around[:, :-1].T / np.maximum(around[:, -1], 1e-6)))

    @cached_property
    def _edge(self) -> float:
        return edge_length(self.places, self.faces)


@dataclass(frozen=True)
class _Photograph:
    """brightness; across and down, how that changes a pixel on; rate, how it changes with linear light; usable, 1 where
    it is of use, else 0: all [H,W] float32."""

    camera: Camera
    brightness: np.ndarray
    across: np.ndarray
    down: np.ndarray
    rate: np.ndarray
    usable: np.ndarray


def _photograph(view: View) -> _Photograph:
    """The mean of the channels, in sRGB, whose noise is more even than linear light's."""
    srgb = view.image.astype(np.float32) / 255
    inside = srgb.max(axis=-1) <= CLIPPED
    if view.alpha is not None:
        inside &= view.alpha >= SOLID * 255
    if view.known is not None:
        inside &= view.known
    mean = srgb.mean(axis=-1)
    share = ndimage.gaussian_filter(inside.astype(np.float32), BLUR)
    brightness = ndimage.gaussian_filter(mean * inside, BLUR) / np.maximum(share, 1e-6)
    down, across = np.gradient(brightness)
    usable = ndimage.binary_erosion(inside, iterations=round(2 * BLUR)).astype(np.float32)
    return _Photograph(view.camera, brightness, across, down, srgb_rate(mean), usable)


@dataclass(frozen=True)
class _Readings:
    """V vertices in K photographs, each [V,K] float32: brightness, less that around the vertex; change, of it for each
    pixel's size that the vertex moves along its normal; mirrored, how much of it is; weights, 0 where the vertex is not
    seen."""

    brightness: np.ndarray
    change: np.ndarray
    mirrored: np.ndarray
    weights: np.ndarray


def _read(surface: _Surface, photographs: Sequence[_Photograph], light: _Light, threads: int | None) -> _Readings:
    rows = map_ahead(lambda each: _read_one(surface, each, light), photographs, threads)
    readings = _Readings(*(np.stack(columns, axis=1) for columns in zip(*rows, strict=True)))
    readings.weights[(readings.weights > 0).sum(axis=1) < MIN_READINGS] = 0
    return readings


def _read_one(surface: _Surface, photograph: _Photograph, light: _Light) -> np.ndarray:
    """A photograph's column of the readings' four, [4,V]."""
    camera, places, normals, pixel = photograph.camera, surface.places, surface.normals, surface.pixel
    offsets = camera.center - places
    towards = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    cosines = (towards * normals).sum(axis=1)
    seen = seen_frontal(surface.caster, camera, places, normals, cosines > MIN_COS, pixel)
    places, normals = places[seen], normals[seen]
    pixels, _ = camera.project(places)
    step = 10 * (camera.project(places + 0.1 * pixel * normals)[0] - pixels)
    slopes = np.stack([read_image(photograph.across, pixels), read_image(photograph.down, pixels)], axis=1)
    told = [read_image(photograph.brightness, pixels), (slopes * step).sum(axis=1)]
    weights = cosines[seen] * (read_image(photograph.usable, pixels) > 0.99)
    if light.lighting is not None:
        falling = light.lighting.falling_on(camera, places, normals)
        lit = np.maximum(falling, DIMMEST) ** (1 / GAMMA)
        told = [each / lit for each in told]
        weights *= lit**2 * (falling >= DIMMEST)
    column = np.zeros((4, len(towards)), np.float32)
    column[:2, seen], column[3, seen] = told, weights
    column[:2] = surface.detail(column[:2], column[3] > 0)
    if light.mirrors is not None:
        shine = light.mirrors.mirrored(surface.normals, towards)
        fine = shine - surface.around(shine, DETAIL)
        column[2, seen] = fine[seen] * read_image(photograph.rate, pixels)
    return column


def _told(readings: _Readings, surface: _Surface) -> tuple[np.ndarray, np.ndarray]:
    """The displacements [V], in pixels, after which the photographs agree best, and what each weighs [V]."""
    weights = readings.weights
    noise = _noise(_apart(readings.brightness, weights), weights)
    weights = weights / (1 + (readings.mirrored / (MIRRORED * noise)) ** 2)
    trusted = weights
    for _ in range(2):
        left = _apart(readings.brightness, trusted)
        noise = _noise(left, weights)
        trusted = weights / (1 + (left / (OUTLIER * noise)) ** 2)
    left, slope = _apart(readings.brightness, trusted), _apart(readings.change, trusted)
    unexplained = (weights * np.minimum(left**2, (10 * noise) ** 2)).sum(axis=1)
    around = surface.around(np.stack([unexplained, weights.sum(axis=1)], axis=1), NOISE)
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
