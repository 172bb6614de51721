"""Valid masks [H,W] bool, which mark the pixels with defined values; None means all.

Undistorting a strong lens leaves corners or sides that the photograph does not cover. Masks may mark further regions to
ignore. All users of a view ignore its invalid pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from mgsr.data.scene import View

# The share of a reduced pixel's area that must be valid for it to count as valid.
NEARLY_ALL = 0.99


def valid_mean(
    pixels: np.ndarray, valid: np.ndarray | None, mean: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the area mean [h,w,C] of the valid pixels, and the valid mask [h,w] of the result, None if all are valid.

    pixels [H,W,C]: the image. valid [H,W] bool: None for all. mean: reduces [H,W,C] to [h,w,C] float. The mean is 0
    where no valid pixel contributes. A pixel of the result is valid if nearly all pixels that it covers are valid.
    """
    if valid is None:
        return mean(pixels), None
    weight = valid[..., None].astype(np.float32)
    sums = mean(np.concatenate([pixels * weight, weight], axis=2))
    share = sums[..., -1:]
    return sums[..., :-1] / np.maximum(share, 1e-6), share[..., 0] >= NEARLY_ALL


def filled(pixels: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Set each invalid pixel of an image to the value of the nearest valid pixel, or to 0 if no pixel is valid.

    pixels [H,W,...]: the image. valid [H,W] bool: the valid mask, None for all.

    Windows and interpolation that cross the edge of the valid region then behave as at the border of an image.
    """
    if valid is None:
        return pixels
    if not valid.any():
        return np.zeros_like(pixels)
    rows, columns = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.asarray(pixels[rows, columns])


def valid_at(valid: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return which of the points `pixels` [P,2], x and y inside the image, lie on pixels of `valid` [H,W]: [P] bool."""
    columns, rows = pixels.astype(np.intp).T
    return np.asarray(valid[rows, columns])


def valid_inside(valid: np.ndarray, reach: int) -> np.ndarray:
    """Return the pixels [H,W] bool whose neighbourhood, `reach` pixels to each side, lies in the image and is valid."""
    return np.asarray(ndimage.minimum_filter(valid, 2 * reach + 1, mode="constant", cval=False))


def whole_part(view: View) -> View:
    """Crop a view to a large rectangle of valid pixels. A view without a valid mask is returned as it is."""
    if view.valid_mask is None:
        return view
    return replace(view.cropped(*largest_rectangle(view.valid_mask)), valid_mask=None)


def largest_rectangle(valid: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns of a large rectangle of valid pixels [H,W] bool.

    Each step cuts the side with the largest share of invalid pixels. If all sides are valid but the inside is not, it
    cuts all sides. If no such rectangle exists, the result is one pixel wide or high, and may be invalid.
    """
    top, bottom, left, right = 0, valid.shape[0], 0, valid.shape[1]
    while bottom - top > 1 and right - left > 1:
        inner = valid[top:bottom, left:right]
        bad = [1 - side.mean() for side in (inner[0], inner[-1], inner[:, 0], inner[:, -1])]
        worst = int(np.argmax(bad))
        if bad[worst] == 0 and inner.all():
            break
        if bad[worst] == 0:
            top, bottom, left, right = top + 1, bottom - 1, left + 1, right - 1
            continue
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return slice(top, bottom), slice(left, right)
