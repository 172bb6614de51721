"""Masks as signed distances to their outlines, precise to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mgsr.data.camera import Camera
from mgsr.data.images import reduce_area
from mgsr.data.scene import View


@dataclass(frozen=True)
class Silhouette:
    """A mask as signed distances [h,w] float32 in pixels to its outline, positive inside, with its camera."""

    camera: Camera
    distance: np.ndarray


def silhouettes(views: Sequence[View], max_side: int) -> list[Silhouette]:
    """The masks of the views that have one, reduced to images of at most `max_side`."""
    return [_silhouette(view, view.alpha, max_side) for view in views if view.alpha is not None]


def signed_distance(alpha: np.ndarray) -> np.ndarray:
    """Pixels [h,w] float32 to the outline at alpha 0.5 of a mask [h,w] 0..1, positive inside; on the outline's own
    pixels alpha, the share of the pixel that is covered, tells the fraction."""
    inside = alpha >= 0.5
    if inside.all() or not inside.any():
        return np.full(alpha.shape, 1e3 if inside.all() else -1e3, dtype=np.float32)
    within = ndimage.distance_transform_edt(inside) - 0.5
    beyond = ndimage.distance_transform_edt(~inside) - 0.5
    distance = np.where(inside, within, -beyond)
    soft = (alpha > 0.02) & (alpha < 0.98) & (np.abs(distance) < 1)
    return np.where(soft, alpha - 0.5, distance).astype(np.float32)


def _silhouette(view: View, mask: np.ndarray, max_side: int) -> Silhouette:
    camera, alpha = view.camera, mask.astype(np.float32)
    shrink = max_side / max(camera.width, camera.height)
    if shrink < 1:
        camera = camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
        alpha = reduce_area(alpha[..., None], camera.width, camera.height)[..., 0]
    return Silhouette(camera, signed_distance(alpha / 255))
