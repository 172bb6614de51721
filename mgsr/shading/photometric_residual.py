"""The photometric residual of a surface under a flash, for the detection of missing holes.

The light of a flash on the camera is fully known. Once the irradiance is divided out, a place has the same brightness
in all photographs. Larger differences than the surface's position error explains show that the surface is wrong there.
For example, it covers a hole.
"""

from __future__ import annotations

import numpy as np

from mgsr.config.expert import ResidualOptions
from mgsr.data.scene import some_of
from mgsr.geometry.decimate import coarser
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead
from mgsr.shading.details import GREY, ChannelMix, KnownLight, ObservedMesh, mix_channels, sample_view
from mgsr.shading.light_models import LightModel
from mgsr.shading.observations import sample_image
from mgsr.shading.photo_set import PhotoSet


def photometric_residual(
    mesh: Mesh,
    photos: PhotoSet,
    light_model: LightModel,
    options: ResidualOptions = ResidualOptions(),
) -> np.ndarray:
    """Return each vertex's photometric residual [V], in sRGB 0..1, above the level of noise.

    It is the median difference between the photographs at the vertex, after correction for the flash's light and for
    the surface's position error. It is 0 where too few photographs show the vertex.
    """
    pixel, threads = photos.pixel_on(mesh), photos.threads
    light = KnownLight.known_by(light_model, mesh)
    coarse = coarser(mesh, options.edge * pixel, options.max_faces)
    surface = ObservedMesh(coarse, pixel, options.details)
    mixes = mix_channels(some_of(photos.photographs), GREY, threads, options.details)
    columns = list(map_ahead(lambda mix: _column(surface, mix, light), mixes, threads))
    values, slopes = (np.stack(each, axis=1) for each in zip(*columns, strict=True))
    apart = np.maximum(np.abs(values - _median(values)[:, None]) - options.surface_error * slopes, 0)
    valid = np.isfinite(values).sum(axis=1) >= options.details.min_observations
    if not valid.any():
        return np.zeros(len(mesh.vertices))
    differing = np.where(valid, _median(apart), 0)
    around = surface.around(np.stack([differing, valid], axis=1), options.averaged)
    differing = around[:, 0] / np.maximum(around[:, 1], 1e-6)
    beyond = valid * np.maximum(differing - options.forgiven * np.median(differing[valid]), 0)
    return np.asarray(coarse.prolongation(mesh.vertices) @ beyond)


def _column(surface: ObservedMesh, mix: ChannelMix, light: KnownLight) -> np.ndarray:
    """Return a photograph's values under even light at the vertices, and their slopes, as [2,V]; NaN where unknown.

    A slope is the magnitude of the image gradient, per pixel.
    """
    samples = sample_view(surface, mix, light)
    values = np.full((2, len(surface.mesh.vertices)), np.nan, np.float32)
    of_use = samples.weights > 0
    pixels = samples.pixels[of_use]
    shown = np.stack([sample_image(mix.mixed, pixels), np.linalg.norm(mix.slopes(pixels), axis=1)])
    values[:, samples.seen[of_use]] = shown / samples.irradiance_factor[of_use]
    return values


def _median(values: np.ndarray) -> np.ndarray:
    """Return the lower median [V] of each row of values [V,K], without NaNs; NaN for a row of NaNs."""
    counts = np.isfinite(values).sum(axis=1, keepdims=True)
    return np.take_along_axis(np.sort(values, axis=1), np.maximum(counts - 1, 0) // 2, axis=1)[:, 0]
