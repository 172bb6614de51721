"""The choice of the light model that explains a capture's photographs on a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mgsr.geometry.decimate import coarser
from mgsr.geometry.mesh import Mesh
from mgsr.shading.flash import flash_ratio
from mgsr.shading.light_models import EnvironmentLight, FlashLight, LightModel, fit_mirrored_environment
from mgsr.shading.photo_set import PhotoSet

# Largest residual ratio of an environment map on an approximate surface; a map with a larger one is rejected.
MAX_ENVIRONMENT_RATIO = 0.85
COMPARED_EDGE = 2.0  # pixels; edge length of the mesh on which the light models are compared


class LightKind(StrEnum):
    """The kind of light in a capture.

    flash: a lamp on the camera. environment: static light that the surface mirrors. unknown: neither explains the
    photographs well enough.
    """

    FLASH = "flash"
    ENVIRONMENT = "environment"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class LightEstimate:
    """The estimate of the light.

    model: the light model, which keeps the lamp's position and refines it with the mesh; None for an unknown light.
    searches: the number of comparisons of the light models, each on a better mesh.
    """

    kind: LightKind = LightKind.UNKNOWN
    model: LightModel | None = None
    searches: int = 0


def estimate_light(mesh: Mesh, photos: PhotoSet, max_ratio: float, known: LightEstimate) -> LightEstimate:
    """Choose the light model with the least residual ratio on a mesh.

    max_ratio: the largest ratio of an accepted model; above it, the light is unknown. known: the previous estimate.
    """
    observer, searches = photos.observer(photos.pixel_on(mesh)), known.searches + 1
    coarse = coarser(mesh, COMPARED_EDGE * observer.pixel)
    observations = observer.observe(coarse)
    by_flash = flash_ratio(observations, coarse.double_normals)
    by_environment = fit_mirrored_environment(observations, coarse.double_normals).ratio
    if not min(by_flash, by_environment) <= max_ratio:
        return LightEstimate(LightKind.UNKNOWN, None, searches)
    if by_flash <= by_environment:
        return LightEstimate(LightKind.FLASH, FlashLight(observer, coarse, observations), searches)
    return LightEstimate(LightKind.ENVIRONMENT, EnvironmentLight(observer), searches)
