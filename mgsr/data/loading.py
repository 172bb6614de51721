"""Turn photographs into views: decoded in parallel, turned, reduced and undistorted, with the masks beside them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import DataConfig, Masks
from mgsr.config.expert import UndistortionOptions
from mgsr.data.camera import Camera
from mgsr.data.capture import Photo
from mgsr.data.images import DecodedImage, read_mask, read_picture, reduce_area, to_uint8, upright
from mgsr.data.masks import fitted_mask
from mgsr.data.pixels import PixelStore
from mgsr.data.scene import View
from mgsr.data.stacking import averaged, stack, unstack
from mgsr.data.undistortion import Undistorter, Undistortion, resample
from mgsr.errors import SceneError
from mgsr.parallel import core_count

# Called with the number of photographs that are loaded and of all.
LoadProgress = Callable[[int, int], None]

# Each thread holds a decoded photograph and its copies, some hundred megabytes for a large one.
_MOST_THREADS = 16

# Seconds between two calls.
_REPORT_EVERY = 2.0


@dataclass(frozen=True)
class LoadedView:
    """A view in the user's frame. Its alpha is the image's own; colours are meaningless where it is zero.

    mask [H,W] uint8: from a file beside the photograph, white on the object or black on the regions to ignore; None
    without such a file.
    ignored [H,W] uint8: from another file, white on the regions to ignore; None without such a file.
    """

    view: View
    mask: np.ndarray | None = None
    ignored: np.ndarray | None = None


@dataclass(frozen=True)
class _Tools:
    """The tools that the loading of all photographs shares."""

    config: DataConfig
    undistort: Undistorter
    pixels: PixelStore


def load_views(
    photos: Sequence[Photo],
    names: Sequence[str],
    config: DataConfig,
    progress: LoadProgress | None = None,
    options: UndistortionOptions = UndistortionOptions(),
) -> list[LoadedView | SceneError]:
    """Decode every photograph once; return its view, or the error of an unreadable one, in the given order.

    Each thread decodes one photograph at a time. Raises the first error once most of the photographs have one.
    """
    pixels = PixelStore()
    tools = _Tools(config, Undistorter(pixels, options), pixels)
    loaded: list[LoadedView | SceneError] = []
    lost: list[SceneError] = []
    reported = time.monotonic()
    # Decoding and resampling release the GIL.
    with ThreadPoolExecutor(min(_MOST_THREADS, core_count(None))) as pool:
        try:
            for item in pool.map(lambda photo, name: _loaded(photo, name, tools), photos, names):
                loaded.append(item)
                if isinstance(item, SceneError):
                    lost.append(item)
                if 2 * len(lost) > len(photos):
                    raise lost[0]
                if progress is not None and time.monotonic() - reported > _REPORT_EVERY:
                    reported = time.monotonic()
                    progress(len(loaded), len(photos))
        except BaseException:
            pool.shutdown(cancel_futures=True)  # so that an unusable capture is reported before all of it is decoded
            raise
    return loaded


def _loaded(photo: Photo, name: str, tools: _Tools) -> LoadedView | SceneError:
    try:
        return _load(photo, name, tools)
    except SceneError as error:
        return error


def _load(photo: Photo, name: str, tools: _Tools) -> LoadedView:
    picture = read_picture(photo.image, photo.source)
    used = tools.config.masks is not Masks.OFF
    masks = [read_mask(path, photo.source) if path and used else None for path in (photo.mask, photo.ignored)]
    picture, masks = _turned(picture, masks, photo)
    height, width = picture.colors.shape[:2]
    view = View(name, _camera(photo, width, height), picture.colors, picture.alpha)
    if max(width, height) > tools.config.max_side or photo.lens is not None:
        view, masks = _resampled(view, masks, photo, tools)
    else:
        masks = [None if mask is None else fitted_mask(mask, width, height, photo) for mask in masks]
    hold = tools.pixels.hold
    alpha, mask, ignored = (None if image is None else hold(image) for image in (view.alpha, *masks))
    return LoadedView(replace(view, image=hold(view.image), alpha=alpha), mask, ignored)


def _turned(
    picture: DecodedImage, masks: list[np.ndarray | None], photo: Photo
) -> tuple[DecodedImage, list[np.ndarray | None]]:
    """Return the photograph and its masks [H,W] in the orientation that its camera was calibrated for.

    The photograph keeps its stored orientation, as in COLMAP, unless only its upright form has the camera's shape.
    Masks of the stored shape turn with it.
    """
    height, width = picture.colors.shape[:2]
    if picture.orientation == 1 or _same_shape(photo.size, (width, height)):
        return picture, masks
    if picture.orientation < 5 or not _same_shape(photo.size, (height, width)):
        return picture, masks
    turned = [
        upright(mask, picture.orientation)
        if mask is not None and _same_shape((width, height), mask.shape[::-1])
        else mask
        for mask in masks
    ]
    alpha = None if picture.alpha is None else upright(picture.alpha, picture.orientation)
    return DecodedImage(upright(picture.colors, picture.orientation), alpha), turned


def _camera(photo: Photo, width: int, height: int) -> Camera:
    """Return the camera for an image of this size, which may be a scaled copy of the calibrated one.

    Raises SceneError where the image has another shape, or where the calibrated size is below 1.
    """
    camera = Camera(photo.K, photo.cam_from_world, *photo.size)
    if photo.size == (width, height):
        return camera
    if min(photo.size) < 1:
        raise SceneError(
            f"{photo.source}: expected an image size of whole numbers above 0, got {photo.size[0]}x{photo.size[1]}"
        )
    if not _same_shape(photo.size, (width, height)):
        raise SceneError(
            f"{photo.source}: the camera is for {photo.size[0]}x{photo.size[1]} pixels, but {photo.image.name} has "
            f"{width}x{height}; use the calibrated image, or a scaled copy with the same aspect ratio"
        )
    return camera.resized(width, height)


def _same_shape(size: tuple[int, ...], copy: tuple[int, ...]) -> bool:
    """Return whether an image of size (width, height) may be a scaled copy of another.

    The sides of a copy are rounded to whole pixels, so its two scales agree only to about a pixel.
    """
    return min(size) > 0 and abs(copy[0] / size[0] - copy[1] / size[1]) * max(size) <= 1.5


def _resampled(
    view: View, masks: list[np.ndarray | None], photo: Photo, tools: _Tools
) -> tuple[View, list[np.ndarray | None]]:
    """Undistort the view and its masks [H,W], and reduce them to at most `max_side` pixels a side.

    Masks that a run has written are of its undistorted photographs, and stay as they are. Colours are meaningless where
    alpha is zero, so alpha weights them.
    """
    premultiply = view.alpha is not None
    width, height = view.camera.width, view.camera.height
    camera, valid, how = view.camera, None, None
    shrink = tools.config.max_side / max(width, height)
    if shrink < 1:
        camera = camera.scaled(shrink)
    if photo.lens is not None:
        how = tools.undistort(photo.lens, camera.K, camera.width, camera.height, photo.source)
    bent = [mask is not None and not _is_undistorted(mask, how, (height, width)) for mask in masks]
    fitted = [
        fitted_mask(mask, width, height, photo)[..., None]
        for mask, is_bent in zip(masks, bent, strict=True)
        if mask is not None and is_bent
    ]
    layers = [stack(view, premultiply), *fitted]
    if shrink < 1:
        layers = [reduce_area(layer, camera.width, camera.height) for layer in layers]
    if how is not None:
        layers, valid = [resample(layer, how) for layer in layers], how.valid_mask
        camera = replace(camera, K=how.K, width=layers[0].shape[1], height=layers[0].shape[0])
    rest = iter(to_uint8(layer[..., 0]) for layer in layers[1:])
    resampled = replace(unstack(view.name, camera, layers[0], premultiply), valid_mask=valid)
    return resampled, [next(rest) if is_bent else mask for mask, is_bent in zip(masks, bent, strict=True)]


def _is_undistorted(mask: np.ndarray, how: Undistortion | None, size: tuple[int, int]) -> bool:
    """Return whether a mask [H,W] has the size of the undistorted photograph and not that of the photograph itself."""
    return how is not None and mask.shape == how.map_x.shape and mask.shape != size


def reduced_view(view: View, scale: float) -> View:
    """Return the view with its sides times `scale`, at most 1, by area filtering (see `averaged`)."""
    camera = view.camera.scaled(scale)
    return averaged(view, camera, lambda pixels: reduce_area(pixels, camera.width, camera.height))
