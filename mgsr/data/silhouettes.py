"""Convert masks to signed distances to their contours, precise to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from mgsr.data.camera import Camera
from mgsr.data.images import reduce_area
from mgsr.data.scene import View
from mgsr.data.valid_mask import valid_mean
from mgsr.parallel import map_ahead

# A mask shows its object completely if it keeps this share of the image's larger side away from the border. A smaller
# margin proves nothing: if the image cuts off the object, its mask may end a few pixels before the border.
FREE_BORDER = 0.02

# A mask is binary if fewer than the share MIN_PARTLY of its contour's pixels are partly covered, by PARTLY at least and
# by 1 - PARTLY at most. 30% of the pixels are in exact masks, and 1% in binary masks that JPEG compressed.
PARTLY, MIN_PARTLY = 0.1, 0.1

# Contours of binary masks are smoothed by a Gaussian with this deviation in pixels, which halves their error: from 0.32
# pixels to 0.17. No pixel changes sides: its centre keeps at least CLOSEST pixels from the contour.
SMOOTHED, CLOSEST = 1.0, 0.02


@dataclass(frozen=True)
class Silhouette:
    """A mask as signed distances [h,w] float32 in pixels to its contour, positive inside, with its camera.

    valid_mask [h,w] bool: the pixels where the mask is known; None means all.
    """

    camera: Camera
    distance: np.ndarray
    valid_mask: np.ndarray | None = None

    def grown(self, pixels: float) -> Silhouette:
        """Return the silhouette with its contour moved outwards."""
        return self if pixels == 0 else replace(self, distance=self.distance + np.float32(pixels))

    @cached_property
    def whole(self) -> bool:
        """Return whether the mask keeps away from the border of the valid region, so that the object is complete."""
        inside = self.distance > 0
        shown = np.pad(np.ones_like(inside) if self.valid_mask is None else self.valid_mask, 1)
        to_border = ndimage.distance_transform_edt(shown)[1:-1, 1:-1]
        return bool(inside.any() and to_border[inside].min() > FREE_BORDER * max(inside.shape))


def view_silhouettes(views: Sequence[View], max_side: int) -> list[Silhouette]:
    """Return the silhouettes of all views with a mask, reduced to at most `max_side` pixels a side."""
    masked = [(view, view.alpha) for view in views if view.alpha is not None]
    return list(map_ahead(lambda item: _silhouette(*item, max_side), masked, None))


def signed_distance(alpha: np.ndarray, valid: np.ndarray | None = None) -> np.ndarray:
    """Return the signed distance [h,w] float32 in pixels to a mask's contour at alpha 0.5, positive inside.

    alpha [h,w]: 0..1, the covered share of each pixel. On the contour's own pixels it gives the distance to a fraction
    of a pixel. A binary mask has no such shares; its contour is smoothed instead.
    valid [h,w] bool: the pixels where the mask is known, None for all. The border of the valid region is no contour,
    just as the image's border is none. Invalid pixels take the side of the nearest valid pixel.
    """
    inside = alpha >= 0.5
    valid_in, valid_out = (inside, ~inside) if valid is None else (inside & valid, ~inside & valid)
    if not valid_in.any() or not valid_out.any():
        return np.full(alpha.shape, -1e3 if valid_out.any() else 1e3, dtype=np.float32)
    within = ndimage.distance_transform_edt(~valid_out) - 0.5
    beyond = ndimage.distance_transform_edt(~valid_in) - 0.5
    soft = (alpha > 0.02) & (alpha < 0.98)
    if valid is not None:
        inside, soft = within > beyond, soft & valid
    distance = np.where(inside, within, -beyond)
    contour = np.abs(distance) < 1
    partly = soft & contour & (np.abs(alpha - 0.5) < 0.5 - PARTLY)
    if partly.sum() < MIN_PARTLY * contour.sum():
        return _without_steps(distance).astype(np.float32)
    return np.where(soft & contour, alpha - 0.5, distance).astype(np.float32)


def _without_steps(distance: np.ndarray) -> np.ndarray:
    """Smooth the signed distances [h,w] of a binary mask near its contour."""
    reach = 3 * SMOOTHED
    smooth = ndimage.gaussian_filter(np.clip(distance, -2 * reach, 2 * reach), SMOOTHED)
    smooth = np.where(distance > 0, np.maximum(smooth, CLOSEST), np.minimum(smooth, -CLOSEST))
    return np.where(np.abs(distance) < reach, smooth, distance)


def _silhouette(view: View, mask: np.ndarray, max_side: int) -> Silhouette:
    """Return the silhouette of a mask [H,W] uint8, reduced to at most `max_side` pixels a side."""
    camera, alpha, valid = view.camera, mask.astype(np.float32)[..., None], view.valid_mask
    shrink = max_side / max(camera.width, camera.height)
    if shrink < 1:
        camera = camera.scaled(shrink)
        alpha, valid = valid_mean(alpha, valid, lambda pixels: reduce_area(pixels, camera.width, camera.height))
    return Silhouette(camera, signed_distance(alpha[..., 0] / 255, valid), valid)
