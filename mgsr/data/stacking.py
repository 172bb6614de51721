"""A view's colours and alpha as one array, for what resamples both alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.images import to_uint8
from mgsr.data.known import known_mean
from mgsr.data.scene import View


def stack(view: View, premultiply: bool) -> np.ndarray:
    """Colours and alpha, if any, as [H,W,3 or 4] in 0..255: with `premultiply` float32, the colours weighted by alpha,
    without which they have no meaning where it is zero; else, and without alpha, uint8 as they are."""
    if view.alpha is None:
        return view.image
    alpha = view.alpha[..., None]
    if not premultiply:
        return np.concatenate([view.image, alpha], axis=2)
    weight = alpha.astype(np.float32)
    return np.concatenate([view.image * (weight / 255), weight], axis=2)


def unstack(name: str, camera: Camera, pixels: np.ndarray, premultiplied: bool) -> View:
    """A view, in bytes, of what became of `stack`'s array: [h,w,3 or 4] in 0..255."""
    colors = pixels[..., :3]
    if pixels.shape[2] == 3:
        return View(name, camera, _bytes(colors))
    alpha = pixels[..., 3]
    if premultiplied:
        colors = colors * (255 / np.maximum(alpha, 1e-3))[..., None]
    return View(name, camera, _bytes(colors), _bytes(alpha))


def averaged(view: View, camera: Camera, mean: Callable[[np.ndarray], np.ndarray]) -> View:
    """The view as a smaller `camera` has it: each pixel the area mean, [H,W,C] to [h,w,C] float, of those that it
    covers. Colours count as alpha says, and unknown pixels not at all."""
    pixels, known = known_mean(stack(view, premultiply=True), view.known, mean)
    lit = None if view.lit is None else _bytes(mean(view.lit[..., None])[..., 0])
    return replace(unstack(view.name, camera, pixels, premultiplied=True), known=known, lit=lit)


def _bytes(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels) if pixels.dtype == np.uint8 else to_uint8(pixels)
