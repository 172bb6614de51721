"""Pixels that a photograph does not show: undoing a strong lens leaves an image whose corners, or sides, nobody saw.

`known` [H,W] bool says which pixels are shown, None that all are. What the others hold means nothing: whoever reads a
view leaves them out by it.
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
    """What an area mean, [H,W,C] to [h,w,C] float, makes of the known ones of the pixels [H,W,C], 0 where it meets
    none; and which of its own are known."""
    if known is None:
        return mean(pixels), None
    weight = known[..., None].astype(np.float32)
    sums = mean(np.concatenate([pixels * weight, weight], axis=2))
    share = sums[..., -1:]
    return sums[..., :-1] / np.maximum(share, 1e-6), share[..., 0] >= NEARLY_ALL


def filled(pixels: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    """The image [H,W,...] with the nearest known pixel's values in the unknown ones, so that windows and interpolation
    which reach over the edge of what is known meet what they do at an image's border. All 0 if nothing is known."""
    if known is None:
        return pixels
    if not known.any():
        return np.zeros_like(pixels)
    rows, columns = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(pixels[rows, columns])


def known_at(known: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Which of the pixel coordinates [P,2], all inside the image, lie on known pixels; [P] bool."""
    columns, rows = pixels.astype(np.intp).T
    return np.asarray(known[rows, columns])


def known_inside(known: np.ndarray, reach: int) -> np.ndarray:
    """[H,W] bool: pixels without anything unknown, or the image's border, within `reach` pixels, diagonals included."""
    return np.asarray(ndimage.minimum_filter(known, 2 * reach + 1, mode="constant", cval=False))


def whole_part(view: View) -> View:
    """The view cut to a large rectangle of which the photograph shows every pixel; the view itself if it shows all."""
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
    """Rows and columns of a large rectangle of known pixels: the worst side is cut until the border is good, and then
    all sides, should unknown pixels lie inside. One pixel, known or not, if there is none."""
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
