"""Mattes of the object in photographs, from the expected colours of object and background."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from scipy.ndimage import gaussian_filter

from mgsr.data.camera import Camera
from mgsr.gaussians.surfels import SurfelModel
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.background import BackgroundSources, Window
from mgsr.segmentation.random_walker import random_walker
from mgsr.training.views import bounding_region

# Colours are sRGB 0..1. A cost is a squared colour difference over twice a variance.
NOISE = 0.02  # standard deviation of a photograph from its known background
SPREAD = 1.5  # times the spread of the background's samples, which adds to NOISE
GUESSED = 0.06  # standard deviation where the background is extrapolated, or only photo-consistency tells
RENDERED = 0.04  # standard deviation of a photograph from the object's rendered surfels
MOST = 9.0  # upper limit of a cost
STRONG = 4.0  # background cost above which a pixel certainly does not show the background
# Prior costs from the hull's silhouette: a distance in pixels, and a cost.
DEEP, INSIDE = 3.0, 6.0  # the cost of the label background farther inside, where the background is known
BESIDE, OUTSIDE = 3.0, 3.0  # the cost of the label object farther outside
SEARCHED = 6.0  # pixels around the hull's silhouette in which the object may lie
FIRST_SEARCHED = 0.12  # the same around the first mask, as a share of the square root of its area
HOLE = 0.005  # area of a hole, as a share of the mask's, below which it is filled: highlights look like background
MARGIN = 4  # pixels by which the processed window exceeds the region

SCALES = (1, 2, 4, 8, 16)  # pixels; the Gaussians' deviations by which colours are extended, in turn
LEAST = 0.1  # blurred weight above which an extended colour counts


@dataclass(frozen=True)
class Matte:
    """The object in a photograph.

    share [H,W] float32: the object's share of each pixel, 0..1. sure [H,W] bool: where the photograph certainly does
    not show the background. told [H,W] bool: where the background is known; `sure` is False elsewhere.
    """

    share: np.ndarray
    sure: np.ndarray
    told: np.ndarray


def first_region(mask: np.ndarray) -> np.ndarray:
    """Return where the object may lie, [H,W] bool: its first mask [H,W] bool, dilated."""
    import cv2  # late: training needs no OpenCV

    reach = max(2, round(FIRST_SEARCHED * float(mask.sum()) ** 0.5))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disk) > 0)


def hull_region(mask: np.ndarray, silhouette: np.ndarray) -> np.ndarray:
    """Return where the object may lie, [H,W] bool: near its hull's silhouette.

    mask [H,W] bool: the object's last mask, inside which the region reaches twice as far. silhouette [H,W]: signed
    distances in pixels, positive inside.
    """
    return np.asarray((silhouette > -SEARCHED) | (mask & (silhouette > -2 * SEARCHED)))


def matte(
    image: np.ndarray,
    camera: Camera,
    region: np.ndarray,
    surfels: SurfelModel,
    sources: BackgroundSources,
    silhouette: np.ndarray | None = None,
) -> Matte:
    """Compute the object's matte in a photograph, inside a region [H,W] bool.

    image [H,W,3] uint8 sRGB. surfels: the object's. silhouette [H,W]: signed distances to the silhouette of the
    object's hull, in pixels, positive inside; None while the hull is unknown.
    """
    found = Matte(np.zeros(region.shape, np.float32), np.zeros(region.shape, bool), np.zeros(region.shape, bool))
    bounds = bounding_region(region, MARGIN)
    if bounds is None:
        return found
    window = slice(*bounds[:2]), slice(*bounds[2:])
    inside = region[window]
    background = sources.expected(image, camera, window, inside)
    known, part = background.known, image[window] / np.float32(255)
    behind, _ = _extended(background.color, known.astype(np.float32))
    variance = np.where(known, NOISE**2 + (SPREAD * background.spread) ** 2, GUESSED**2)
    as_background = _cost(_squared(part - behind), variance)
    color, covered = _object_colors(surfels, camera, window)
    as_object = np.where(covered, _cost(_squared(part - color), RENDERED**2), MOST)
    tested = np.isfinite(background.behind)
    as_background = np.where(tested, _cost(background.behind, GUESSED**2), as_background)
    as_object = np.where(tested, np.minimum(as_object, _cost(background.above, GUESSED**2)), as_object)
    # Where both costs are equal, the image's edges decide.
    towards = as_background - as_object
    for_object, for_background = np.maximum(towards, 0), np.maximum(-towards, 0)
    if silhouette is not None:
        for_object += INSIDE * ((silhouette[window] > DEEP) & known)
        for_background += OUTSIDE * (silhouette[window] < -BESIDE)
    found.share[window] = without_small_holes(random_walker(part, for_object, for_background, inside))
    found.sure[window], found.told[window] = known & (as_background > STRONG), known
    return found


def _squared(difference: np.ndarray) -> np.ndarray:
    """Return the squared lengths [h,w] of colour differences [h,w,3]."""
    return np.asarray((difference**2).sum(axis=-1))


def _cost(squared: np.ndarray, variance: np.ndarray | float) -> np.ndarray:
    """Return the costs [h,w] of squared colour differences [h,w]."""
    return np.asarray(np.minimum(squared / (2 * variance), MOST))


def without_small_holes(share: np.ndarray) -> np.ndarray:
    """Return the shares [h,w] with small holes of the object filled."""
    mask = share > 0.5
    holes, count = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    small = np.bincount(holes.ravel(), minlength=count + 1) < HOLE * mask.sum()
    small[0] = False
    return np.where(small[holes], np.float32(1), share)


def _object_colors(surfels: SurfelModel, camera: Camera, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Render the object's colours in a window, and extend them beyond its surfels.

    Returns the colours [h,w,3] sRGB 0..1, and where they are known, [h,w] bool.
    """
    with torch.no_grad():
        shown = render_surfels(surfels, camera, torch.zeros(3))
    alpha = shown.alpha.numpy()[window]
    solid = alpha > 0.5
    color = np.where(solid[..., None], shown.color.numpy()[window] / np.maximum(alpha, 0.5)[..., None], 0)
    return _extended(color, solid.astype(np.float32))


def _extended(color: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extend colours [h,w,3] from pixels of weight 1 to pixels of weight 0, by Gaussian blurs of growing scale.

    weight [h,w]: 0 or 1. Returns the colours [h,w,3], and where they are known, [h,w] bool.
    """
    found, reached = color * weight[..., None], weight > 0
    for scale in SCALES:
        near = gaussian_filter(weight, scale)
        blurred = gaussian_filter(color * weight[..., None], (scale, scale, 0))
        fresh = (near > LEAST) & ~reached
        found[fresh] = blurred[fresh] / near[fresh][:, None]
        reached = reached | fresh
    return found, reached
