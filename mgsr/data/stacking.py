"""A view's colours and alpha as one array, so that both are resampled alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.images import to_uint8
from mgsr.data.scene import View
from mgsr.data.valid_mask import valid_mean


def stack(view: View, premultiply: bool) -> np.ndarray:
    """Return colours and alpha, if any, as one array [H,W,3 or 4] in 0..255.

    premultiply: weight the colours by alpha, as float32; colours have no meaning where alpha is zero. Otherwise, and
    without alpha, the array is uint8 and unchanged.
    """
    if view.alpha is None:
        return view.image
    alpha = view.alpha[..., None]
    if not premultiply:
        return np.concatenate([view.image, alpha], axis=2)
    weight = alpha.astype(np.float32)
    return np.concatenate([view.image * (weight / 255), weight], axis=2)


def unstack(name: str, camera: Camera, pixels: np.ndarray, premultiplied: bool) -> View:
    """Return the uint8 view of a resampled array from `stack`, [h,w,3 or 4] in 0..255."""
    colors = pixels[..., :3]
    if pixels.shape[2] == 3:
        return View(name, camera, _bytes(colors))
    alpha = pixels[..., 3]
    if premultiplied:
        colors = colors * (255 / np.maximum(alpha, 1e-3))[..., None]
    return View(name, camera, _bytes(colors), _bytes(alpha))


def averaged(view: View, camera: Camera, mean: Callable[[np.ndarray], np.ndarray]) -> View:
    """Return the view as a smaller `camera` has it, by area means.

    mean: maps [H,W,C] to [h,w,C] float. Colours are weighted by alpha, and invalid pixels do not count.
    """
    pixels, valid = valid_mean(stack(view, premultiply=True), view.valid_mask, mean)
    irradiance = None if view.irradiance is None else _bytes(mean(view.irradiance[..., None])[..., 0])
    return replace(unstack(view.name, camera, pixels, premultiplied=True), valid_mask=valid, irradiance=irradiance)


def _bytes(pixels: np.ndarray) -> np.ndarray:
    """Return pixels [H,W,C] as uint8, without a copy where they already are."""
    return np.ascontiguousarray(pixels) if pixels.dtype == np.uint8 else to_uint8(pixels)
