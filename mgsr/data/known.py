"""Pixels that a photograph does not show: undistorting a strong lens leaves corners or sides that no pixel covers.

`known` [H,W] bool says which pixels are shown; None means all. The others hold no meaning, and whoever reads a view
leaves them out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from mgsr.data.scene import View

# The share of a reduced pixel's area that must be known for it to count as known.
NEARLY_ALL = 0.99


def known_mean(
    pixels: np.ndarray, known: np.ndarray | None, mean: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the area mean of the known pixels, and which of the resulting pixels are known.

    pixels: [H,W,C]. mean: maps [H,W,C] to [h,w,C] float. The result is 0 where no known pixel contributes. It counts as
    known where nearly all pixels that it covers are; None where all pixels are known.
    """
    if known is None:
        return mean(pixels), None
    weight = known[..., None].astype(np.float32)
    sums = mean(np.concatenate([pixels * weight, weight], axis=2))
    share = sums[..., -1:]
    return sums[..., :-1] / np.maximum(share, 1e-6), share[..., 0] >= NEARLY_ALL


def filled(pixels: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    """Return the image [H,W,...] with each unknown pixel set to the nearest known one; all 0 if nothing is known.

    Windows and interpolation that reach over the edge of the known region then see what they see at an image's border.
    """
    if known is None:
        return pixels
    if not known.any():
        return np.zeros_like(pixels)
    rows, columns = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(pixels[rows, columns])


def known_at(known: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return which pixel coordinates [P,2], all inside the image, lie on known pixels, [P] bool."""
    columns, rows = pixels.astype(np.intp).T
    return np.asarray(known[rows, columns])


def known_inside(known: np.ndarray, reach: int) -> np.ndarray:
    """Return the pixels [H,W] bool that have only known pixels of the image within `reach`, diagonals included."""
    return np.asarray(ndimage.minimum_filter(known, 2 * reach + 1, mode="constant", cval=False))


def whole_part(view: View) -> View:
    """Return the view cut to a large rectangle of known pixels; the view itself if it shows all."""
    if view.known is None:
        return view
    rows, columns = largest_rectangle(view.known)
    K = view.camera.K.copy()
    K[:2, 2] -= columns.start, rows.start
    height, width = rows.stop - rows.start, columns.stop - columns.start
    camera = replace(view.camera, K=K, width=width, height=height)
    alpha = None if view.alpha is None else view.alpha[rows, columns]
    return View(view.name, camera, view.image[rows, columns], alpha)


def largest_rectangle(known: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns of a large rectangle of known pixels.

    Each step cuts the side with the most unknown pixels. Where all borders are known but the inside is not, it cuts all
    sides. The result is one pixel wide or high, known or not, where no such rectangle exists.
    """
    top, bottom, left, right = 0, known.shape[0], 0, known.shape[1]
    while bottom - top > 1 and right - left > 1:
        inner = known[top:bottom, left:right]
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
