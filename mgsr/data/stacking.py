"""Join the colours and the alpha of a view in one array, so that both are resampled alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.images import to_uint8
from mgsr.data.scene import View
from mgsr.data.valid_mask import valid_mean


def stack(view: View, premultiply: bool) -> np.ndarray:
    """Return the colours and the alpha, if any, as one array [H,W,3 or 4] in 0..255.

    premultiply: whether to multiply the colours by alpha, in float32, because colours have no meaning where alpha is
    zero. Without it, and without alpha, the array is uint8 and the colours are unchanged.
    """
    if view.alpha is None:
        return view.image
    alpha = view.alpha[..., None]
    if not premultiply:
        return np.concatenate([view.image, alpha], axis=2)
    weight = alpha.astype(np.float32)
    return np.concatenate([view.image * (weight / 255), weight], axis=2)


def unstack(name: str, camera: Camera, pixels: np.ndarray, premultiplied: bool) -> View:
    """Return a uint8 view from a resampled array of `stack`, `pixels` [h,w,3 or 4] in 0..255."""
    colors = pixels[..., :3]
    if pixels.shape[2] == 3:
        return View(name, camera, _bytes(colors))
    alpha = pixels[..., 3]
    if premultiplied:
        colors = colors * (255 / np.maximum(alpha, 1e-3))[..., None]
    return View(name, camera, _bytes(colors), _bytes(alpha))


def averaged(view: View, camera: Camera, mean: Callable[[np.ndarray], np.ndarray]) -> View:
    """Reduce a view to a smaller `camera` by area means.

    mean: reduces [H,W,C] to [h,w,C] float. Colours are weighted by alpha, and invalid pixels do not count.
    """
    pixels, valid = valid_mean(stack(view, premultiply=True), view.valid_mask, mean)
    irradiance = None if view.irradiance is None else _bytes(mean(view.irradiance[..., None])[..., 0])
    small = unstack(view.name, camera, pixels, premultiplied=True)
    return replace(small, valid_mask=valid, irradiance=irradiance, white=view.white)


def _bytes(pixels: np.ndarray) -> np.ndarray:
    """Return pixels [H,W,C] as uint8, without a conversion if they are already."""
    return np.ascontiguousarray(pixels) if pixels.dtype == np.uint8 else to_uint8(pixels)
