"""The initial surface where masks tell the object: the visual hull, corrected by the photographs.

PatchMatch stereo finds the concavities that no silhouette shows; in photographs of half the size it finds, more
coarsely, what is too faint for it in whole ones. On a mirror it finds what is mirrored instead, behind the surface; so
the hull stays where it explains the photographs better, as a whole or at a place. Then the surface is bent to what
shading tells, and moved by what parallax tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, hull_surface
from mgsr.data.scene import View
from mgsr.data.silhouettes import Silhouette
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.parallel import map_ahead
from mgsr.shading.environment_residual import EnvironmentResidual, environment_residuals
from mgsr.shading.light_estimate import MAX_ENVIRONMENT_RATIO, LightEstimate, LightKind, estimate_light
from mgsr.shading.lighting import Lighting
from mgsr.shading.photo_set import PhotoSet
from mgsr.shading.photometric_refinement import refine_photometrically
from mgsr.shading.shape_from_shading import ShadingPass, shape_from_shading
from mgsr.stereo.fusion import fuse, fuse_roughly
from mgsr.stereo.patch_match import DepthMap, match_views, weigh, weigh_gaps
from mgsr.stereo.photographs import StereoPhotographs, stereo_photographs

# The residual under an environment map on the hull, as a share of that on the surface that stereo finds, under which
# the surface is a mirror.
CLEARLY = 0.9
# A hull's large shape is wrong too, so shading may change more of it than of a trained surface. Deep concavities
# need many rounds. An environment map says little about a hull's steps, which are smoothed away in between, and more
# about the small shape once photometric refinement has corrected the large one.
FAR_PASSES = {
    LightKind.FLASH: (ShadingPass(edge=2.0, rounds=6, reach=160.0), ShadingPass(edge=1.5, rounds=3, reach=60.0)),
    LightKind.ENVIRONMENT: (
        *[ShadingPass(edge=4.0, rounds=2, reach=240.0, fairing=17.0)] * 3,
        ShadingPass(edge=3.0, rounds=2, reach=240.0, fairing=17.0),
        ShadingPass(edge=2.0, rounds=2, reach=120.0, fairing=17.0),
    ),
}
NEAR_PASSES = {LightKind.ENVIRONMENT: (ShadingPass(edge=1.5, rounds=2, reach=60.0, fairing=17.0),)}

# Octaves of deviation by which the residual of stereo's surface may exceed the hull's before it no longer counts.
DISBELIEVED = 0.3

# Share of the sides to which photographs are reduced for the coarser stereo.
HALF = 0.5

# Pixels over which a displacement of the photometric refinement spreads.
PHOTOMETRIC_REACH = 12.0

# Shares of the time at which the parts are done, measured on 48 views of 256 x 256 pixels.
HALVES_MATCHED, MATCHED, FUSED, FAR_SHADED, NEAR_BEGUN, NEAR_SHADED = 0.1, 0.4, 0.6, 0.83, 0.87, 0.92


@dataclass(frozen=True)
class MaskedSurface:
    """The initial surface of a masked object.

    mesh: in the scene's frame, its faces outward; light: the light of the photographs, as far as they tell; lighting: a
    flash's light on the surface, None without one.
    """

    mesh: Mesh
    light: LightKind
    lighting: Lighting | None


def find_surface(
    views: Sequence[View],
    silhouettes: Sequence[Silhouette],
    hull: Hull,
    seed: int,
    progress: Callable[[float], None] = lambda done: None,
) -> MaskedSurface:
    """Find the surface of the masked object inside its visual hull. The same seed gives the same surface.

    progress: told of the share of the work that is done, 0..1. Raises SceneError if the hull is empty.
    """
    photos = PhotoSet(views, silhouettes)
    mesh = _likelier_surface(photos, hull, seed, progress)
    progress(FUSED)
    mesh, estimate = _refined(mesh, photos, LightEstimate(), FAR_PASSES, _between(progress, FUSED, FAR_SHADED))
    if estimate.kind in NEAR_PASSES:
        mesh, estimate = _refined(mesh, photos, estimate, NEAR_PASSES, _between(progress, NEAR_BEGUN, NEAR_SHADED))
    progress(1.0)
    lighting = None if estimate.model is None else estimate.model.lighting(mesh)
    return MaskedSurface(mesh, estimate.kind, lighting)


def _likelier_surface(photos: PhotoSet, hull: Hull, seed: int, progress: Callable[[float], None]) -> Mesh:
    """Return the hull's surface where it explains the photographs clearly better than stereo's; else stereo's.

    The hull wins where a mirrored environment map explains the photographs on it. For stereo's surface, pixels count
    the less the better the hull explains them. What a surface mirrors moves across it as a pattern behind it would, and
    stereo cannot tell the two apart.
    """
    outer = Mesh(*hull_surface(hull))
    seen = _matched(stereo_photographs(photos.views), outer.caster, seed, progress)
    inner = fuse_roughly(seen.cameras, seen.maps, seen.weights, hull, seen.pixel)
    if not len(inner.faces):
        return outer
    on_outer, on_inner = environment_residuals((outer, inner), photos)
    if on_outer.ratio <= MAX_ENVIRONMENT_RATIO and on_outer.ratio <= CLEARLY * on_inner.ratio:
        return outer
    believed = map_ahead(lambda camera: _believed(camera, on_outer, on_inner), seen.cameras, None)
    weights = [weight * share for weight, share in zip(seen.weights, believed, strict=True)]
    fused = fuse(seen.cameras, seen.maps, weights, hull, seen.pixel)
    return fused if len(fused.faces) else outer


@dataclass(frozen=True)
class _Matched:
    """Depth maps of photographs at two sizes.

    cameras: of the maps; maps; weights: of their pixels; pixel: the size of the finer pixels on the object.
    """

    cameras: Sequence[Camera]
    maps: Sequence[DepthMap]
    weights: Sequence[np.ndarray]
    pixel: float


def _matched(
    photographs: StereoPhotographs, start: RayCaster, seed: int, progress: Callable[[float], None]
) -> _Matched:
    halves = photographs.reduced(HALF)
    coarse = match_views(halves, start, seed, progress=_between(progress, 0, HALVES_MATCHED))
    fine = match_views(photographs, start, seed, progress=_between(progress, HALVES_MATCHED, MATCHED))
    weights = weigh(photographs, fine)
    weights += weigh_gaps(weigh(halves, coarse), weights)
    pixel = pixel_size(photographs.cameras, np.zeros(3))
    return _Matched(photographs.cameras + halves.cameras, fine + coarse, weights, pixel)


def _believed(camera: Camera, outer: EnvironmentResidual, inner: EnvironmentResidual) -> np.ndarray:
    """Return how much each pixel of stereo counts, [H,W] 0..1.

    It counts less the more the inner surface leaves unexplained there, in octaves of the deviation over what the outer
    one leaves; where either tells nothing, 1.
    """
    residual, before = inner.seen_by(camera), outer.seen_by(camera)
    known = (residual > 0) & (before > 0)
    octaves = np.log2(np.where(known, residual, 1) / np.where(known, before, 1)) / 2
    return np.asarray(np.clip(1 - octaves / DISBELIEVED, 0, 1) ** 2, np.float32)


def _refined(
    mesh: Mesh,
    photos: PhotoSet,
    known: LightEstimate,
    passes: Mapping[LightKind, Sequence[ShadingPass]],
    progress: Callable[[float], None],
) -> tuple[Mesh, LightEstimate]:
    """Estimate the light anew on the mesh as it is, and refine the mesh by shading and photometrically."""
    estimate = estimate_light(mesh, photos, MAX_ENVIRONMENT_RATIO, known)
    mesh = shape_from_shading(mesh, photos, estimate, passes, progress)
    return refine_photometrically(mesh, photos, PHOTOMETRIC_REACH, estimate.model), estimate


def _between(progress: Callable[[float], None], begin: float, end: float) -> Callable[[float], None]:
    """Return a progress callback for a part of the work that goes from `begin` to `end` of the whole."""
    return lambda done: progress(begin + (end - begin) * done)
