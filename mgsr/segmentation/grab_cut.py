"""Refinement of an object's mask in one photograph by GrabCut (Rother, Kolmogorov and Blake 2004)."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from mgsr.training.views import bounding_region

ROUNDS = 3  # of fitting the colour models and cutting
GROW = 0.5  # share of the band by which a mask may grow; shadows would else be taken for dark parts of the object
HOLE = 0.15  # side of the largest hole that is filled, as a share of the square root of the mask's area
EDGE = 1  # pixels by which what renders as the ground may be off


def refined_mask(image: np.ndarray, mask: np.ndarray, band: float, outside: np.ndarray | None = None) -> np.ndarray:
    """Move a mask's contour to where the colours change, within a band around it.

    image [H,W,3] uint8 sRGB; mask [H,W] bool. band: the band's width inside the contour, as a share of the square root
    of the mask's area. outside [H,W] bool: what is surely not the object, but for its rim of EDGE pixels. Returns
    [H,W] bool; a mask too small for a band stays as it is.
    """
    import cv2  # late: training needs no OpenCV

    reach = max(2, round(band * float(mask.sum()) ** 0.5))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    plain = mask.astype(np.uint8)
    grow = max(1, round(GROW * reach))
    outer = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * grow + 1, 2 * grow + 1))
    core, wide = cv2.erode(plain, disk) > 0, cv2.dilate(plain, outer) > 0
    if not core.any() or wide.all():
        return mask
    if outside is not None:
        wide &= ~(cv2.erode(outside.astype(np.uint8), np.ones((2 * EDGE + 1, 2 * EDGE + 1), np.uint8)) > 0) | mask
    labels = np.select([core, mask, wide], [cv2.GC_FGD, cv2.GC_PR_FGD, cv2.GC_PR_BGD], cv2.GC_BGD).astype(np.uint8)
    region = bounding_region(wide, 3 * reach + 10)
    assert region is not None
    window = slice(*region[:2]), slice(*region[2:])
    cut, background, foreground = np.ascontiguousarray(labels[window]), np.zeros((1, 65)), np.zeros((1, 65))
    colors, nowhere = np.ascontiguousarray(image[window][..., ::-1]), (0, 0, 1, 1)  # of a rectangle, which is not used
    cv2.setRNGSeed(0)
    cv2.grabCut(colors, cut, nowhere, background, foreground, ROUNDS, cv2.GC_INIT_WITH_MASK)
    refined = np.zeros_like(mask)
    refined[window] = (cut == cv2.GC_FGD) | (cut == cv2.GC_PR_FGD)
    return without_small_holes(refined)


def without_small_holes(mask: np.ndarray) -> np.ndarray:
    """Fill the holes of a mask [H,W] bool that are small against it: spots of another colour, not openings."""
    holes, count = ndimage.label(~mask)
    sizes = np.bincount(holes.ravel(), minlength=count + 1)
    small = sizes < (HOLE * float(mask.sum()) ** 0.5) ** 2
    small[0] = False
    return np.asarray(mask | small[holes])
