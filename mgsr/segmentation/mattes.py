"""Mattes of the object in photographs, from the expected colours of object and background."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from mgsr.config.expert import MatteOptions
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.gaussians.surfels import SurfelModel
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.background import BackgroundSources, Window, squared_difference
from mgsr.segmentation.color_models import ColorModels
from mgsr.segmentation.random_walker import random_walker
from mgsr.training.views import bounding_box


@dataclass(frozen=True)
class Matte:
    """The object in a photograph.

    share [H,W] float32: the object's share of each pixel, 0..1. certain [H,W] bool: where the photograph certainly does
    not show the background. background_known [H,W] bool: where the background is known; `certain` is False elsewhere.
    gaps [H,W] bool: where the photograph shows the background inside the hull's silhouette, in gaps that reach its rim.
    """

    share: np.ndarray
    certain: np.ndarray
    background_known: np.ndarray
    gaps: np.ndarray


def first_region(mask: np.ndarray, options: MatteOptions = MatteOptions()) -> np.ndarray:
    """Return where the object may lie, [H,W] bool: its first mask [H,W] bool, dilated."""
    import cv2  # imported here, because training needs no OpenCV

    reach = max(2, round(options.first_searched * float(mask.sum()) ** 0.5))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disk) > 0)


def hull_region(mask: np.ndarray, silhouette: np.ndarray, options: MatteOptions = MatteOptions()) -> np.ndarray:
    """Return where the object may lie, [H,W] bool: near its hull's silhouette.

    mask [H,W] bool: the object's last mask, inside which the region reaches twice as far. silhouette [H,W]: signed
    distances in pixels, positive inside.
    """
    reach = options.searched
    return np.asarray((silhouette > -reach) | (mask & (silhouette > -2 * reach)))


def matte(
    view: View,
    region: np.ndarray,
    surfels: SurfelModel,
    sources: BackgroundSources,
    silhouette: np.ndarray | None = None,
    options: MatteOptions = MatteOptions(),
    models: ColorModels | None = None,
) -> Matte:
    """Compute the object's matte in a photograph, inside a region [H,W] bool.

    view: the photograph. Where it is clipped, a brighter expected colour is no difference.
    surfels: the object's surfels.
    silhouette [H,W]: signed distances to the silhouette of the object's hull, in pixels, positive inside; None while
    the hull is unknown.
    models: the colour models, which decide where the background is unknown; None while they are unknown.
    """
    nowhere = np.zeros(region.shape, bool)
    found = Matte(np.zeros(region.shape, np.float32), nowhere, nowhere.copy(), nowhere.copy())
    window = bounding_box(region, options.margin)
    if window is None:
        return found
    inside = region[window]
    background = sources.expected(view, window, inside)
    known, part = background.known, view.image[window] / np.float32(255)
    clipped = None if view.white is None else view.image[window] >= view.white
    behind, _ = _extended(background.color, known.astype(np.float32), options)
    variance = np.where(known, options.noise**2 + (options.spread * background.spread) ** 2, options.guessed**2)
    as_background = _cost(squared_difference(part, behind, clipped), variance, options, options.unsure)
    color, covered = _object_colors(surfels, view.camera, window, options)
    as_object = np.where(
        covered, _cost(squared_difference(part, color, clipped), options.rendered**2, options), options.max_cost
    )
    tested, above = np.isfinite(background.behind), _cost(background.above, options.guessed**2, options)
    as_background = np.where(tested, _cost(background.behind, options.guessed**2, options), as_background)
    as_object = np.where(tested, np.minimum(as_object, above), as_object)
    if models is not None and tested.any():
        # A label is cheap only if the photographs agree at its place and its model contains the pixel's colour.
        unlike_object, unlike_support = (np.minimum(cost, options.max_cost) for cost in models.costs(part[tested]))
        as_object[tested] = np.maximum(as_object[tested], unlike_object)
        as_background[tested] = np.maximum(as_background[tested], unlike_support)
    # Where both costs are equal, the image's edges decide.
    advantage = as_background - as_object
    for_object, for_background = np.maximum(advantage, 0), np.maximum(-advantage, 0)
    if silhouette is not None:
        deep = silhouette[window] > options.deep
        found.gaps[window] = _gaps(known & (for_background > options.gap_cost), deep)
        for_object += options.deep_cost * (deep & known & ~found.gaps[window])
        for_background += options.outside_cost * (silhouette[window] < -options.outside)
    share = random_walker(part, for_object, for_background, inside, options.walker)
    found.share[window] = without_small_holes(share, options.max_hole)
    found.certain[window], found.background_known[window] = known & (as_background > options.certain_cost), known
    return found


def _gaps(background: np.ndarray, deep: np.ndarray) -> np.ndarray:
    """Return the gaps [h,w] bool in the hull's silhouette through which the background shows.

    The tolerant hull fills gaps that few photographs see. A gap reaches the silhouette's rim; background farther inside
    is the object in the background's colour.
    background [h,w] bool: the pixels like the background and unlike the object. deep [h,w] bool: all pixels but those
    outside the silhouette and on its rim.
    """
    wide = ndimage.binary_opening(background)
    return np.asarray(ndimage.binary_propagation(wide & ~deep, mask=wide))


def _cost(squared: np.ndarray, variance: np.ndarray | float, options: MatteOptions, unsure: float = 0.0) -> np.ndarray:
    """Return the costs [h,w] of squared colour differences [h,w] with a variance, a number or [h,w].

    unsure: the additional cost where the standard deviation is e times `options.guessed`.
    """
    cost = squared / (2 * variance) + unsure * np.log(np.maximum(variance / options.guessed**2, 1)) / 2
    return np.asarray(np.minimum(cost, options.max_cost))


def without_small_holes(share: np.ndarray, largest: float = MatteOptions().max_hole) -> np.ndarray:
    """Fill small holes of the object in shares [h,w]; largest: their largest area, as a share of the mask's."""
    mask = share > 0.5
    holes, count = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    small = np.bincount(holes.ravel(), minlength=count + 1) < largest * mask.sum()
    small[0] = False
    return np.where(small[holes], np.float32(1), share)


def _object_colors(
    surfels: SurfelModel, camera: Camera, window: Window, options: MatteOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Render the object's colours in a window, and extend them beyond its surfels.

    Returns the colours [h,w,3] sRGB 0..1, and where they are known, [h,w] bool.
    """
    with torch.no_grad():
        shown = render_surfels(surfels, camera, torch.zeros(3))
    alpha = shown.alpha.numpy()[window]
    solid = alpha > 0.5
    color = np.where(solid[..., None], shown.color.numpy()[window] / np.maximum(alpha, 0.5)[..., None], 0)
    return _extended(color, solid.astype(np.float32), options)


def _extended(color: np.ndarray, weight: np.ndarray, options: MatteOptions) -> tuple[np.ndarray, np.ndarray]:
    """Extend colours [h,w,3] from pixels of weight 1 to pixels of weight 0, by Gaussian blurs of growing scale.

    weight [h,w]: 0 or 1. Returns the colours [h,w,3], and where they are known, [h,w] bool.
    """
    import cv2  # imported here, because training needs no OpenCV

    found, reached = color * weight[..., None], weight > 0
    weighted = np.ascontiguousarray(np.dstack([found, weight]), np.float32)
    for number in range(options.scales):
        blurred = cv2.GaussianBlur(weighted, (0, 0), 2**number, borderType=cv2.BORDER_REFLECT)
        near = blurred[..., 3]
        fresh = (near > options.min_weight) & ~reached
        found[fresh] = blurred[fresh, :3] / near[fresh][:, None]
        reached = reached | fresh
    return found, reached
