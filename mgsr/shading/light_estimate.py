"""The light of a capture: which light model explains its photographs on a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mgsr.geometry.decimate import coarser
from mgsr.geometry.mesh import Mesh
from mgsr.shading.flash import flash_ratio
from mgsr.shading.light_models import EnvironmentLight, FlashLight, LightModel, fit_mirrored_environment
from mgsr.shading.photo_set import Observer, PhotoSet

# The share of what differs between the photographs that an environment map may leave unexplained on a surface that is
# known roughly; a map that leaves more is not believed.
MAX_ENVIRONMENT_RATIO = 0.85
COMPARED_EDGE = 2.0  # pixels; edges of the mesh on which the light models are compared


class LightKind(StrEnum):
    """The light of a capture, as far as the photographs tell.

    flash: on the camera; environment: standing still, mirrored by the surface; unknown: neither explains enough.
    """

    FLASH = "flash"
    ENVIRONMENT = "environment"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class LightEstimate:
    """What is known of the light.

    model: None for an unknown light; it keeps the lamp's place and refines it with the mesh. searches: how often the
    light models have been compared, each time on a better mesh.
    """

    kind: LightKind = LightKind.UNKNOWN
    model: LightModel | None = None
    searches: int = 0


def estimate_light(mesh: Mesh, photos: PhotoSet, max_ratio: float, known: LightEstimate) -> LightEstimate:
    """Choose the light model that leaves the least residual on a mesh as it is.

    Where that is more than the share `max_ratio`, the light is unknown. known: the estimate so far.
    """
    observer = Observer(photos.linear, photos.pixel_on(mesh), photos.threads)
    coarse, searches = coarser(mesh, COMPARED_EDGE * observer.pixel), known.searches + 1
    observations = observer.observe(coarse)
    by_flash = flash_ratio(observations, coarse.double_normals)
    by_environment = fit_mirrored_environment(observations, coarse.double_normals).ratio
    if not min(by_flash, by_environment) <= max_ratio:
        return LightEstimate(LightKind.UNKNOWN, None, searches)
    if by_flash <= by_environment:
        return LightEstimate(LightKind.FLASH, FlashLight(observer, coarse, observations), searches)
    return LightEstimate(LightKind.ENVIRONMENT, EnvironmentLight(observer), searches)
