"""Photographs to views: decoded in parallel, turned, reduced, undistorted, with their masks settled."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import DataConfig, Masks
from mgsr.data.camera import Camera
from mgsr.data.capture import Photo
from mgsr.data.images import Picture, composite_on_white, read_mask, read_picture, reduce_area, upright
from mgsr.data.known import whole_part
from mgsr.data.masks import fitted_mask, inverted_masks
from mgsr.data.pixels import PixelStore
from mgsr.data.scene import View
from mgsr.data.stacking import averaged, stack, unstack
from mgsr.data.undistortion import Undistorter, resample
from mgsr.errors import SceneError
from mgsr.parallel import core_count

# Called with the number of photographs that are loaded and of all.
LoadProgress = Callable[[int, int], None]

# Each holds a photograph as it is decoded, and its copies: some hundred megabytes where it is large.
_MOST_THREADS = 16

# Seconds between two calls of it.
_REPORT_EVERY = 2.0


@dataclass(frozen=True)
class LoadedView:
    """A view in the user's frame; cut_out tells whether the alpha came with the colours (so they mean nothing
    where it is zero) and not from a mask beside a whole photograph."""

    view: View
    cut_out: bool


@dataclass(frozen=True)
class _Tools:
    """What the loading of all photographs shares."""

    config: DataConfig
    undistort: Undistorter
    pixels: PixelStore


def load_views(
    photos: Sequence[Photo], names: Sequence[str], config: DataConfig, progress: LoadProgress | None = None
) -> list[LoadedView]:
    """Every photograph, decoded once; in the order given. At most as many as there are threads are in work at a time,
    beside the finished ones. Raises SceneError for the first that can't be used."""
    pixels = PixelStore()
    tools = _Tools(config, Undistorter(pixels), pixels)
    loaded: list[LoadedView] = []
    reported = time.monotonic()
    # Decoding and resampling let go of the interpreter lock.
    with ThreadPoolExecutor(min(_MOST_THREADS, core_count(None))) as pool:
        try:
            for item in pool.map(lambda photo, name: _load(photo, name, tools), photos, names):
                loaded.append(item)
                if progress is not None and time.monotonic() - reported > _REPORT_EVERY:
                    reported = time.monotonic()
                    progress(len(loaded), len(photos))
        except BaseException:
            pool.shutdown(cancel_futures=True)  # else a bad first photograph is told after all others are decoded
            raise
    return loaded


@dataclass(frozen=True)
class SettledViews:
    """Views of which all training views have a mask, or no view has; and notes for the person on what is left out."""

    train: list[View]
    test: list[View]
    notes: tuple[str, ...] = ()


def settle_masks(train: list[LoadedView], test: list[LoadedView], masks: Masks) -> SettledViews:
    """The views with masks if `masks` allows and every training view has one, else all without.

    Alpha that is 255 in all views is no mask. Views that lose the alpha of their own colours are put on white. With
    masks, views in which they show nothing are left out.
    Raises SceneError under Masks.REQUIRE, for masks that are white around the object, and where they show nothing in
    most training views.
    """
    bare = [item.view.name for item in train if item.view.alpha is None]
    solid = all(_solid(item.view) for item in train)
    if masks is Masks.REQUIRE and (bare or solid):
        missing = f"view {bare[0]!r} has none" if bare else "every mask is white all over"
        raise SceneError(f"masks=require: {missing}; add alpha channels or a masks/ folder, or use masks=auto")
    if masks is Masks.OFF or bare or solid:
        notes = () if masks is Masks.OFF else _unused_masks(train, bare)
        return SettledViews([_drop_alpha(item) for item in train], [_drop_alpha(item) for item in test], notes)
    shown, notes = _with_an_object(train)
    masks_shown = (whole_part(item.view).alpha for item in shown)
    if inverted_masks([mask for mask in masks_shown if mask is not None]):
        raise SceneError(
            "the masks are inverted: white around the object and black on it; make them white on the object, or run "
            "with masks=off"
        )
    return SettledViews([item.view for item in shown], [item.view for item in test if not _empty(item.view)], notes)


def _unused_masks(train: list[LoadedView], bare: list[str]) -> tuple[str, ...]:
    """What is said of masks that some views have, or that tell nothing."""
    if bare and len(bare) < len(train):
        having = f"{len(train) - len(bare)} of {len(train)} training views have a mask"
        return (f"{having}, but {bare[0]!r} has none: masks are not used",)
    if not bare and not all(item.cut_out for item in train):
        return ("every mask is white all over: masks are not used",)
    return ()


def _with_an_object(train: list[LoadedView]) -> tuple[list[LoadedView], tuple[str, ...]]:
    """The views in whose masks there is something, and a note on the others."""
    shown = [item for item in train if not _empty(item.view)]
    if len(shown) == len(train):
        return train, ()
    first = next(item.view for item in train if _empty(item.view))
    count = f"the masks of {len(train) - len(shown)} of {len(train)} training views are empty"
    if len(shown) < max(2, len(train) / 2):
        raise SceneError(
            f"{count}: the largest value in that of {first.name!r} is {_brightest(first)} of 255, and 128 or more is "
            "the object; make them white on the object, or run with masks=off"
        )
    return shown, (f"{count} ({first.name!r}): these views are left out",)


def _empty(view: View) -> bool:
    return view.alpha is not None and _brightest(view) < 128


def _brightest(view: View) -> int:
    """The largest value of the mask where the photograph shows something."""
    assert view.alpha is not None, "called for views with masks"
    return int((view.alpha if view.known is None else view.alpha[view.known]).max(initial=0))


def _solid(view: View) -> bool:
    """Whether nothing that the photograph shows lies off the object, as far as the view says."""
    if view.alpha is None:
        return True
    shown = view.alpha if view.known is None else view.alpha[view.known]
    return bool(shown.min() == 255)


def _drop_alpha(item: LoadedView) -> View:
    view = item.view
    if item.cut_out and view.alpha is not None:
        view = replace(view, image=composite_on_white(view.image, view.alpha))
    return replace(view, alpha=None)


def _load(photo: Photo, name: str, tools: _Tools) -> LoadedView:
    picture = read_picture(photo.image, photo.source)
    mask = read_mask(photo.mask, photo.source) if photo.mask and tools.config.masks is not Masks.OFF else None
    picture, mask = _turned(picture, mask, photo)
    height, width = picture.colors.shape[:2]
    if mask is not None:
        mask = fitted_mask(mask, width, height, photo)
    camera = _camera(photo, width, height)
    view = View(name, camera, picture.colors, _both(picture.alpha, mask))
    if max(width, height) > tools.config.max_side or photo.lens is not None:
        view = _resampled(view, photo, tools, premultiply=picture.alpha is not None)
    held = replace(
        view,
        image=tools.pixels.hold(view.image),
        alpha=None if view.alpha is None else tools.pixels.hold(view.alpha),
    )
    return LoadedView(held, cut_out=picture.alpha is not None)


def _turned(picture: Picture, mask: np.ndarray | None, photo: Photo) -> tuple[Picture, np.ndarray | None]:
    """The photograph as the camera was calibrated for it: as it is stored, as in COLMAP, unless only its upright form
    has the camera's shape. A mask of the stored form is turned along."""
    height, width = picture.colors.shape[:2]
    if picture.orientation == 1 or _same_shape(photo.size, (width, height)):
        return picture, mask
    if picture.orientation < 5 or not _same_shape(photo.size, (height, width)):
        return picture, mask
    if mask is not None and _same_shape((width, height), mask.shape[::-1]):
        mask = upright(mask, picture.orientation)
    alpha = None if picture.alpha is None else upright(picture.alpha, picture.orientation)
    return Picture(upright(picture.colors, picture.orientation), alpha), mask


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
    if not _same_shape(photo.size, (width, height)):
        raise SceneError(
            f"{photo.source}: the camera is for {photo.size[0]}x{photo.size[1]} pixels, but {photo.image.name} has "
            f"{width}x{height}; give the calibrated image, or a scaled copy of the same shape"
        )
    return camera.resized(width, height)


def _same_shape(size: tuple[int, ...], copy: tuple[int, ...]) -> bool:
    """Whether an image of one size, (width, height), may be a scaled copy of the other: a copy's sides are rounded to
    whole pixels, so its two scales agree to about a pixel only."""
    return min(size) > 0 and abs(copy[0] / size[0] - copy[1] / size[1]) * max(size) <= 1.5


def _resampled(view: View, photo: Photo, tools: _Tools, premultiply: bool) -> View:
    """The view at most `max_side` large and without its lens. Colours that have no meaning where alpha is zero are
    weighted by it."""
    pixels = stack(view, premultiply)
    camera, known = view.camera, None
    shrink = tools.config.max_side / max(camera.width, camera.height)
    if shrink < 1:
        camera = camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
        pixels = reduce_area(pixels, camera.width, camera.height)
    if photo.lens is not None:
        how = tools.undistort(photo.lens, camera.K, camera.width, camera.height, photo.source)
        pixels, known = resample(pixels, how), how.known
        camera = replace(camera, K=how.K, width=pixels.shape[1], height=pixels.shape[0])
    return replace(unstack(view.name, camera, pixels, premultiply), known=known)


def reduced_view(view: View, scale: float) -> View:
    """The view with its sides times `scale`, at most 1, and area filtering (see `averaged`)."""
    camera = view.camera
    camera = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    return averaged(view, camera, lambda pixels: reduce_area(pixels, camera.width, camera.height))
