"""The photometric residual of a surface under a flash, by which holes are found.

A flash on the camera leaves nothing unknown of the light, so that each place should be as bright in one photograph as
in another once the light on it is divided out. Where they differ by more than the surface's own error explains, they
look past it: into a hole that it covers, say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.data.camera import pixel_size
from mgsr.data.scene import View, some_of
from mgsr.geometry.decimate import coarser
from mgsr.geometry.displace import uniform_laplacian
from mgsr.geometry.raycast import prolongation_matrix
from mgsr.parallel import map_ahead
from mgsr.shading.details import GREY, MIN_OBSERVATIONS, ChannelMix, KnownLight, Surface, mix_channels, sample_view
from mgsr.shading.light_models import LightModel
from mgsr.shading.observations import read_image

EDGE = 1.5  # pixels; edges of the mesh at whose vertices the photographs are read
OFF = 0.7  # pixels by which the surface may be off; differences that this explains do not count
AROUND = 3.0  # pixels over which disagreement is averaged
USUAL = 6.0  # times what is usual all over the surface, which is noise and gloss; so much is forgiven


def photometric_residual(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[View],
    light_model: LightModel,
    threads: int | None = None,
) -> np.ndarray:
    """Return each vertex's photometric residual [V], in sRGB 0..1, less what is usual all over the surface.

    vertices [V,3]; faces [F,3]. It tells how much the photographs differ about the vertex, once the flash's light and
    an error of OFF pixels in the surface are taken off; 0 where too few photographs show it.
    """
    pixel = pixel_size([view.camera for view in views], vertices.mean(axis=0))
    light = KnownLight.known_by(light_model, vertices, faces)
    places, triangles = coarser(vertices, faces, EDGE * pixel)
    surface = Surface(places, triangles, uniform_laplacian(triangles, len(places)), pixel)
    photographs = mix_channels(some_of(views), GREY, threads)
    columns = list(map_ahead(lambda photograph: _column(surface, photograph, light), photographs, threads))
    values, slopes = (np.stack(each, axis=1) for each in zip(*columns, strict=True))
    centered = np.maximum(np.abs(values - _median(values)[:, None]) - OFF * slopes, 0)
    told = np.isfinite(values).sum(axis=1) >= MIN_OBSERVATIONS
    if not told.any():
        return np.zeros(len(vertices))
    differing = np.where(told, _median(centered), 0)
    around = surface.around(np.stack([differing, told], axis=1), AROUND)
    differing = around[:, 0] / np.maximum(around[:, 1], 1e-6)
    beyond = told * np.maximum(differing - USUAL * np.median(differing[told]), 0)
    return np.asarray(prolongation_matrix(places, triangles, vertices) @ beyond)


def _column(surface: Surface, photograph: ChannelMix, light: KnownLight) -> np.ndarray:
    """Return a photograph's values at the vertices under even light, and their slopes: [2,V], NaN where unknown.

    A slope is the change of the value from a pixel to the next.
    """
    look = sample_view(surface, photograph, light)
    told = np.full((2, len(surface.places)), np.nan, np.float32)
    of_use = look.weights > 0
    pixels = look.pixels[of_use]
    shown = np.stack([read_image(photograph.mixed, pixels), np.linalg.norm(photograph.slopes(pixels), axis=1)])
    told[:, look.seen[of_use]] = shown / look.lit[of_use]
    return told


def _median(values: np.ndarray) -> np.ndarray:
    """Return the median of each row's numbers that are not NaN (of two in the middle, the lower), [V]; else NaN.

    values [V,K].
    """
    counts = np.isfinite(values).sum(axis=1, keepdims=True)
    return np.take_along_axis(np.sort(values, axis=1), np.maximum(counts - 1, 0) // 2, axis=1)[:, 0]
