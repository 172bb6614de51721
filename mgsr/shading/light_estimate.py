"""The choice of the light model that explains a capture's photographs on a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.config.expert import LightOptions
from mgsr.geometry.mesh import Mesh
from mgsr.shading.flash import flash_ratio
from mgsr.shading.light_kind import LightKind
from mgsr.shading.light_models import EnvironmentLight, FlashLight, LightModel, fit_mirrored_environment
from mgsr.shading.photo_set import PhotoSet


@dataclass(frozen=True)
class LightEstimate:
    """The estimate of the light.

    model: the light model, which keeps the lamp's position and refines it with the mesh; None for an unknown light.
    searches: the number of comparisons of the light models, each on a better mesh.
    """

    kind: LightKind = LightKind.UNKNOWN
    model: LightModel | None = None
    searches: int = 0


def estimate_light(
    mesh: Mesh, photos: PhotoSet, max_ratio: float, known: LightEstimate, options: LightOptions = LightOptions()
) -> LightEstimate:
    """Choose the light model with the least residual ratio on a mesh.

    max_ratio: the largest ratio of an accepted model; above it, the light is unknown. known: the previous estimate.
    """
    observer, searches = photos.observer(photos.pixel_on(mesh)), known.searches + 1
    coarse, mirrored = observer.coarser(mesh, options.edge, options.max_faces), options.environment
    observations = observer.observe(coarse)
    by_flash = flash_ratio(observations, coarse.double_normals, options.flash)
    environment = fit_mirrored_environment(observations, coarse.double_normals, mirrored)
    if not min(by_flash, environment.ratio) <= max_ratio:
        return LightEstimate(LightKind.UNKNOWN, None, searches)
    if by_flash <= environment.ratio:
        return LightEstimate(LightKind.FLASH, FlashLight(observer, coarse, observations, options.flash), searches)
    same = (options.edge, options.max_faces) == (mirrored.edge, mirrored.max_faces)
    model = EnvironmentLight(observer, mirrored, (mesh, environment) if same else None)
    return LightEstimate(LightKind.ENVIRONMENT, model, searches)
