"""Photographs to views: decoded in parallel, reduced, undistorted, with their masks settled."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import DataConfig, Masks
from mgsr.data.camera import Camera
from mgsr.data.capture import Photo
from mgsr.data.images import composite_on_white, read_image, read_mask, reduce_area, to_uint8
from mgsr.data.lens import resample, undistortion
from mgsr.data.scene import View
from mgsr.errors import SceneError


@dataclass(frozen=True)
class LoadedView:
    """A view in the user's frame; cut_out tells whether the alpha came with the colours (so they mean nothing
    where it is zero) and not from a mask beside a whole photograph."""

    view: View
    cut_out: bool


def load_views(photos: Sequence[Photo], names: Sequence[str], config: DataConfig) -> list[LoadedView]:
    """Every photograph, decoded; in the order given. Raises SceneError for the first that can't be used."""
    # Decoding and resampling let go of the interpreter lock; more threads than that only cost memory.
    with ThreadPoolExecutor(max_workers=min(8, os.cpu_count() or 1)) as pool:
        return list(pool.map(lambda photo, name: _load(photo, name, config), photos, names))


def settle_masks(train: list[LoadedView], test: list[LoadedView], masks: Masks) -> tuple[list[View], list[View]]:
    """The views with masks if `masks` allows and every training view has one, else all without.

    Alpha that is 255 in all views is no mask. Views that lose the alpha of their own colours are put on white.
    Raises SceneError under Masks.REQUIRE.
    """
    bare = next((item.view.name for item in train if item.view.alpha is None), None)
    solid = all(item.view.alpha is None or item.view.alpha.min() == 255 for item in train)
    if masks is Masks.REQUIRE and (bare is not None or solid):
        missing = f"view {bare!r} has none" if bare is not None else "every mask is white all over"
        raise SceneError(f"masks=require: {missing}; add alpha channels or a masks/ folder, or use masks=auto")
    keep = masks is not Masks.OFF and bare is None and not solid
    settle = _keep_alpha if keep else _drop_alpha
    return [settle(item) for item in train], [settle(item) for item in test]


def _keep_alpha(item: LoadedView) -> View:
    return item.view


def _drop_alpha(item: LoadedView) -> View:
    view = item.view
    if item.cut_out and view.alpha is not None:
        view = replace(view, image=composite_on_white(view.image, view.alpha))
    return replace(view, alpha=None)


def _load(photo: Photo, name: str, config: DataConfig) -> LoadedView:
    colors, own_alpha = read_image(photo.image, photo.source)
    height, width = colors.shape[:2]
    camera = _camera(photo, width, height)
    mask = read_mask(photo.mask, photo.source) if photo.mask and config.masks is not Masks.OFF else None
    if mask is not None and mask.shape != (height, width):
        raise SceneError(
            f"mask {photo.mask}: {mask.shape[1]}x{mask.shape[0]} pixels, but its image has {width}x{height}; "
            "give the mask the image's size"
        )
    view = View(name, camera, colors, _both(own_alpha, mask))
    if max(width, height) > config.max_side or photo.lens is not None:
        view = _resampled(view, photo, config.max_side, premultiply=own_alpha is not None)
    return LoadedView(view, cut_out=own_alpha is not None)


def _both(alpha: np.ndarray | None, mask: np.ndarray | None) -> np.ndarray | None:
    if alpha is None or mask is None:
        return mask if alpha is None else alpha
    return np.minimum(alpha, mask)


def _camera(photo: Photo, width: int, height: int) -> Camera:
    """The camera for an image of this size, which may be a reduced copy of the one that was calibrated."""
    camera = Camera(photo.K, photo.cam_from_world, *photo.size)
    if photo.size == (width, height):
        return camera
    if min(photo.size) < 1:
        raise SceneError(f"{photo.source}: image size {photo.size[0]}x{photo.size[1]}; expected whole numbers above 0")
    # A copy's sides are rounded to whole pixels, so its two scales agree to about a pixel only.
    if abs(width / photo.size[0] - height / photo.size[1]) * max(photo.size) > 1.5:
        raise SceneError(
            f"{photo.source}: the camera is for {photo.size[0]}x{photo.size[1]} pixels, but {photo.image.name} has "
            f"{width}x{height}; give the calibrated image, or a scaled copy of the same shape"
        )
    return camera.resized(width, height)


def _resampled(view: View, photo: Photo, max_side: int, premultiply: bool) -> View:
    """The view at most `max_side` large and without its lens. Colours that have no meaning where alpha is zero are
    weighted by it."""
    pixels = _stack(view, premultiply)
    camera = view.camera
    shrink = max_side / max(camera.width, camera.height)
    if shrink < 1:
        camera = camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
        pixels = reduce_area(pixels, camera.width, camera.height)
    if photo.lens is not None:
        how = undistortion(photo.lens, camera.K, camera.width, camera.height, photo.source)
        pixels = resample(np.ascontiguousarray(pixels), how)
        camera = replace(camera, K=how.K, width=pixels.shape[1], height=pixels.shape[0])
    return _unstack(view.name, camera, pixels, premultiply)


def _stack(view: View, premultiply: bool) -> np.ndarray:
    """Colours and alpha, if any, as [H,W,3 or 4] float32 in 0..255."""
    colors = view.image.astype(np.float32)
    if view.alpha is None:
        return colors
    alpha = view.alpha.astype(np.float32)[..., None]
    return np.concatenate([colors * (alpha / 255) if premultiply else colors, alpha], axis=2)


def _unstack(name: str, camera: Camera, pixels: np.ndarray, premultiplied: bool) -> View:
    colors = pixels[..., :3]
    if pixels.shape[2] == 3:
        return View(name, camera, to_uint8(colors))
    alpha = pixels[..., 3]
    if premultiplied:
        colors = colors * (255 / np.maximum(alpha, 1e-3))[..., None]
    return View(name, camera, to_uint8(colors), to_uint8(alpha))
