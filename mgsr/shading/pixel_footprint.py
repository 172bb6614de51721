"""Correction of observations for the footprints of pixels.

A pixel shows the mean of a surface patch, and interpolation between pixels averages over a larger patch. So creases
look flatter than they are, and borders of paint look like shading.

The current surface, rendered through the same pixels, is blurred in the same way. This module subtracts the effect of
that blur from each observation. A surface that explains the photographs then also explains its observations. This is
deferred correction; for images, it is Van Cittert's deconvolution (1931).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mgsr.config.expert import FlashOptions
from mgsr.data.photograph import Photograph
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import PixelHits, RayCaster
from mgsr.parallel import map_ahead
from mgsr.shading.observations import Observations, sample_image


def deconvolve(
    observations: Observations,
    mesh: Mesh,
    photographs: Sequence[Photograph],
    shown: Callable[[int, np.ndarray], np.ndarray],
    threads: int | None = None,
    rays: int = FlashOptions().footprint_rays,
) -> Observations:
    """Return the observations of a mesh's vertices, corrected for the blur of the pixels' footprints.

    shown: a function of a photograph's index and vertex indices [P]. It returns the modelled brightness [P] of these
    vertices in that photograph, as single points, in linear light. rays: along a pixel's side.
    """
    vertices, faces, caster = mesh.vertices, mesh.faces, mesh.caster
    brightness = observations.brightness.copy()

    def take_off(number: int) -> None:
        photograph = photographs[number]
        read, columns = np.nonzero((observations.photographs == number) & (observations.weights > 0))
        pixels, _ = photograph.camera.project(vertices[read])
        hits = _cast(caster, photograph, rays)
        needed = np.unique(np.concatenate([faces[hits.face[hits.mask]].ravel(), read]))
        points = np.zeros(len(vertices), np.float32)
        points[needed] = shown(number, needed)
        image, known = _through_pixels(hits, faces, points, photograph.usable)
        brightness[read, columns] += sample_image(known, pixels) * points[read] - sample_image(image, pixels)

    deque(map_ahead(take_off, range(len(photographs)), threads), maxlen=0)
    return replace(observations, brightness=brightness)


def _cast(caster: RayCaster, photograph: Photograph, rays: int) -> PixelHits:
    """Cast n x n rays, n = `rays`, through each of a photograph's U usable pixels; return the hits [U,n,n]."""
    rows, columns = np.nonzero(photograph.usable)
    inside = (np.arange(rays) + 0.5) / rays
    pixels = np.empty((len(rows), rays, rays, 2))
    pixels[..., 0], pixels[..., 1] = columns[:, None, None] + inside, rows[:, None, None] + inside[:, None]
    return caster.cast_pixels(photograph.camera, pixels)


def _through_pixels(
    hits: PixelHits, faces: np.ndarray, points: np.ndarray, usable: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Render the brightness of vertices through the usable pixels: return an image [H,W] and its coverage [H,W].

    hits [U,n,n]: of the usable pixels' rays. faces [F,3]: vertex indices. points [V]: the vertices' brightness.
    usable [H,W] bool. The coverage is 1 where a ray hits a face; elsewhere both are 0.
    """
    met = hits.mask
    seen, counts = np.zeros(met.shape, np.float32), met.sum(axis=(1, 2))
    seen[met] = (points[faces[hits.face[met]]] * hits.barycentric[met]).sum(axis=-1)
    image, known = np.zeros((2, *usable.shape), np.float32)
    image[usable], known[usable] = seen.sum(axis=(1, 2)) / np.maximum(counts, 1), counts > 0
    return image, known
