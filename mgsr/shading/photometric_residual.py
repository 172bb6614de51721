"""The photometric residual of a surface under a flash, by which holes are found.

A flash on the camera leaves nothing unknown of the light, so that each place should be as bright in one photograph as
in another once the light on it is divided out. Where they differ by more than the surface's own error explains, they
look past it: into a hole that it covers, say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgsr.data.scene import some_of
from mgsr.geometry.decimate import coarser
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead
from mgsr.shading.details import GREY, MIN_OBSERVATIONS, ChannelMix, KnownLight, ObservedMesh, mix_channels, sample_view
from mgsr.shading.light_models import LightModel
from mgsr.shading.observations import read_image
from mgsr.shading.photo_set import PhotoSet


@dataclass(frozen=True)
class ResidualOptions:
    """Numbers of the photometric residual."""

    edge: float = 1.5  # pixels; edges of the mesh at whose vertices the photographs are read
    surface_error: float = 0.7  # pixels by which the surface may be off; differences that this explains do not count
    averaged: float = 3.0  # pixels over which the residual is averaged
    forgiven: float = 6.0  # times the median over the surface, which is noise and gloss


def photometric_residual(
    mesh: Mesh,
    photos: PhotoSet,
    light_model: LightModel,
    options: ResidualOptions = ResidualOptions(),
) -> np.ndarray:
    """Return each vertex's photometric residual [V], in sRGB 0..1, less what is usual all over the surface.

    It tells how much the photographs differ about the vertex, once the flash's light and an error in the surface's
    place are taken off; 0 where too few photographs show it.
    """
    pixel, threads = photos.pixel_on(mesh), photos.threads
    light = KnownLight.known_by(light_model, mesh)
    coarse = coarser(mesh, options.edge * pixel)
    surface = ObservedMesh(coarse, pixel)
    photographs = mix_channels(some_of(photos.views), GREY, threads)
    columns = list(map_ahead(lambda photograph: _column(surface, photograph, light), photographs, threads))
    values, slopes = (np.stack(each, axis=1) for each in zip(*columns, strict=True))
    apart = np.maximum(np.abs(values - _median(values)[:, None]) - options.surface_error * slopes, 0)
    told = np.isfinite(values).sum(axis=1) >= MIN_OBSERVATIONS
    if not told.any():
        return np.zeros(len(mesh.vertices))
    differing = np.where(told, _median(apart), 0)
    around = surface.around(np.stack([differing, told], axis=1), options.averaged)
    differing = around[:, 0] / np.maximum(around[:, 1], 1e-6)
    beyond = told * np.maximum(differing - options.forgiven * np.median(differing[told]), 0)
    return np.asarray(coarse.prolongation(mesh.vertices) @ beyond)


def _column(surface: ObservedMesh, photograph: ChannelMix, light: KnownLight) -> np.ndarray:
    """Return a photograph's values at the vertices under even light, and their slopes: [2,V], NaN where unknown.

    A slope is the change of the value from a pixel to the next.
    """
    samples = sample_view(surface, photograph, light)
    told = np.full((2, len(surface.mesh.vertices)), np.nan, np.float32)
    of_use = samples.weights > 0
    pixels = samples.pixels[of_use]
    shown = np.stack([read_image(photograph.mixed, pixels), np.linalg.norm(photograph.slopes(pixels), axis=1)])
    told[:, samples.seen[of_use]] = shown / samples.lit[of_use]
    return told


def _median(values: np.ndarray) -> np.ndarray:
    """Return the median of each row's numbers that are not NaN (of two in the middle, the lower), [V]; else NaN.

    values [V,K].
    """
    counts = np.isfinite(values).sum(axis=1, keepdims=True)
    return np.take_along_axis(np.sort(values, axis=1), np.maximum(counts - 1, 0) // 2, axis=1)[:, 0]
