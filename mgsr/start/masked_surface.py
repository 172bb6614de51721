"""The initial surface of a masked object: the visual hull, corrected by the photographs.

PatchMatch stereo finds concavities that no silhouette shows. It also runs on photographs of half the size, where it
matches weaker texture at a coarser resolution. On a mirroring surface, stereo finds the reflections, which lie behind
the surface. Wherever the hull explains the photographs better, it therefore replaces stereo's surface. Shape from
shading and photometric refinement then improve the result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config import ExpertConfig
from mgsr.config.expert import FirstSurfaceOptions, ShadingPass
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, hull_surface
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.parallel import map_ahead
from mgsr.shading.environment_residual import EnvironmentResidual, environment_residuals
from mgsr.shading.light_estimate import LightEstimate, estimate_light
from mgsr.shading.light_kind import LightKind
from mgsr.shading.lighting import Lighting
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.photometric_refinement import refine_photometrically
from mgsr.shading.shape_from_shading import shape_from_shading
from mgsr.stereo.fusion import fuse, fuse_roughly
from mgsr.stereo.patch_match import DepthMap, match_views, weigh, weigh_gaps
from mgsr.stereo.photographs import StereoPhotographs, stereo_photographs

# Progress at the end of each part, measured as shares of the time on 48 views of 256 x 256 pixels.
HALVES_MATCHED, MATCHED, FUSED, FAR_SHADED, NEAR_STARTED, NEAR_SHADED = 0.1, 0.4, 0.6, 0.83, 0.87, 0.92


@dataclass(frozen=True)
class MaskedSurface:
    """The initial surface of a masked object.

    mesh: in the scene's frame, its faces outward. light: the kind of light, as estimated from the photographs.
    lighting: a flash's light on the surface, None without a flash.
    """

    mesh: Mesh
    light: LightKind
    lighting: Lighting | None


def find_surface(
    photos: PhotoSet,
    hull: Hull,
    seed: int,
    progress: Callable[[float], None] = lambda done: None,
    expert: ExpertConfig = ExpertConfig(),
) -> MaskedSurface:
    """Find the surface of the masked object inside its visual hull. The same seed gives the same surface.

    photos: the training photographs and their silhouettes. progress: receives the share of the work that is done, 0..1.
    expert: the options of all algorithms.

    Raises SceneError if the hull is empty.
    """
    options = expert.start.surface
    passes, last = _far_passes(options), _near_passes(options)
    mesh = _hull_or_stereo_surface(photos, hull, seed, progress, expert)
    progress(FUSED)
    far, near = _between(progress, FUSED, FAR_SHADED), _between(progress, NEAR_STARTED, NEAR_SHADED)
    mesh, estimate = _refined(mesh, photos, LightEstimate(), passes, far, expert, options.max_bent_residual)
    if estimate.kind in last:
        mesh, estimate = _refined(mesh, photos, estimate, last, near, expert)
    progress(1.0)
    lighting = None if estimate.model is None else estimate.model.lighting(mesh)
    return MaskedSurface(mesh, estimate.kind, lighting)


def _hull_or_stereo_surface(
    photos: PhotoSet, hull: Hull, seed: int, progress: Callable[[float], None], expert: ExpertConfig
) -> Mesh:
    """Return the hull's surface if the photographs clearly prefer it, else the surface that stereo finds.

    Reflections move across a surface like a pattern behind it, and stereo cannot distinguish the two. So if a mirrored
    environment map explains the photographs on the hull, the hull is kept. Otherwise stereo's depths are fused. A depth
    weighs less where the hull explains its pixel better.
    """
    outer = Mesh(*hull_surface(hull))
    prepared, fusion = stereo_photographs(photos.views, expert.stereo.max_object_pixels), expert.stereo.fusion
    seen = _matched(prepared, outer.caster, seed, progress, expert)
    inner = fuse_roughly(seen.cameras, seen.maps, seen.weights, hull, seen.pixel, fusion)
    if not len(inner.faces):
        return outer
    light, options = expert.shading.light, expert.start.surface
    on_outer, on_inner = environment_residuals((outer, inner), photos, light.environment)
    if on_outer.ratio <= light.max_environment_ratio and on_outer.ratio <= options.max_hull_residual * on_inner.ratio:
        return outer
    believed = map_ahead(lambda camera: _believed(camera, on_outer, on_inner, options.disbelieved), seen.cameras, None)
    weights = [weight * share for weight, share in zip(seen.weights, believed, strict=True)]
    fused = fuse(seen.cameras, seen.maps, weights, hull, seen.pixel, fusion)
    return fused if len(fused.faces) else outer


def _far_passes(options: FirstSurfaceOptions) -> Mapping[LightKind, Sequence[ShadingPass]]:
    """Return the shading passes on the surface of stereo or of the hull."""
    coarse = [options.environment_coarse] * options.environment_repeats
    return {
        LightKind.FLASH: (options.flash_coarse, options.flash_fine),
        LightKind.ENVIRONMENT: (*coarse, options.environment_medium, options.environment_fine),
    }


def _near_passes(options: FirstSurfaceOptions) -> Mapping[LightKind, Sequence[ShadingPass]]:
    """Return the shading passes on the surface after photometric refinement."""
    return {LightKind.ENVIRONMENT: (options.environment_last,)}


@dataclass(frozen=True)
class _Matched:
    """Depth maps of photographs at two sizes.

    cameras, maps: a camera for each depth map.
    weights [h,w]: the weights of each map's pixels.
    pixel: the size of the finer maps' pixels on the object, in the scene's unit.
    """

    cameras: Sequence[Camera]
    maps: Sequence[DepthMap]
    weights: Sequence[np.ndarray]
    pixel: float


def _matched(
    photographs: StereoPhotographs,
    start: RayCaster,
    seed: int,
    progress: Callable[[float], None],
    expert: ExpertConfig,
) -> _Matched:
    """Match the photographs at two sizes; the coarser maps fill the finer ones' gaps.

    start: the surface on which the search begins.
    """
    surface, options = expert.start.surface, expert.stereo
    halves = photographs.reduced(surface.coarse_scale)
    coarse = match_views(halves, start, seed, options.match, _between(progress, 0, HALVES_MATCHED))
    fine = match_views(photographs, start, seed, options.match, _between(progress, HALVES_MATCHED, MATCHED))
    weights = weigh(photographs, fine, options.consistency)
    gaps = weigh_gaps(weigh(halves, coarse, options.consistency), weights)
    weights += [surface.coarse_weight * each for each in gaps]
    pixel = pixel_size(photographs.cameras, np.zeros(3))
    return _Matched(photographs.cameras + halves.cameras, fine + coarse, weights, pixel)


def _believed(camera: Camera, outer: EnvironmentResidual, inner: EnvironmentResidual, disbelieved: float) -> np.ndarray:
    """Return the confidence [H,W] 0..1 in each pixel of stereo's surface.

    The confidence falls where the residual of stereo's surface, `inner`, exceeds that of the hull, `outer`. It is 1
    where either residual is unknown. disbelieved: the excess, in octaves, at which the confidence is 0.
    """
    residual, before = inner.seen_by(camera), outer.seen_by(camera)
    known = (residual > 0) & (before > 0)
    octaves = np.log2(np.where(known, residual, 1) / np.where(known, before, 1)) / 2
    return np.asarray(np.clip(1 - octaves / disbelieved, 0, 1) ** 2, np.float32)


def _refined(
    mesh: Mesh,
    photos: PhotoSet,
    known: LightEstimate,
    passes: Mapping[LightKind, Sequence[ShadingPass]],
    progress: Callable[[float], None],
    expert: ExpertConfig,
    max_residual: float | None = None,
) -> tuple[Mesh, LightEstimate]:
    """Estimate the light on the mesh, then refine the mesh by shape from shading and photometrically.

    max_residual: the largest residual under an environment map that the bent mesh may have, as a share of the residual
    before; None for any. If more is left, the map does not explain the brightness: the mesh stays, and the light is
    unknown.
    """
    options, light, reach = expert.shading, expert.shading.light, expert.start.surface.photometric_reach
    estimate = estimate_light(mesh, photos, light.max_environment_ratio, known, light)
    bent = shape_from_shading(mesh, photos, estimate, passes, progress, options=options.shape)
    if max_residual is not None and estimate.kind is LightKind.ENVIRONMENT:
        before, after = (each.ratio for each in environment_residuals((mesh, bent), photos, light.environment))
        if after > max_residual * before:
            bent, estimate = mesh, LightEstimate(searches=estimate.searches)
    moved = refine_photometrically(bent, photos, reach, estimate.model, options=options.photometric)
    return moved, estimate


def _between(progress: Callable[[float], None], begin: float, end: float) -> Callable[[float], None]:
    """Return a progress callback for the part of the work from `begin` to `end`, both 0..1."""
    return lambda done: progress(begin + (end - begin) * done)
