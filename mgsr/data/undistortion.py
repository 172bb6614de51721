"""Undistortion: resample photographs to the images of pinhole cameras."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config.expert import UndistortionOptions
from mgsr.data.images import to_uint8
from mgsr.data.lens import AnyLens
from mgsr.data.pixels import PixelStore
from mgsr.data.valid_mask import largest_rectangle
from mgsr.errors import SceneError

# The number of cached undistortions. It is limited because the maps of 2 megapixels take 16 MB, and each photograph may
# have a camera of its own.
_KEPT = 8

# Rows per block. The working set stays in the CPU's cache, so maps take an eighth of the time of whole images.
_BAND = 32


@dataclass(frozen=True)
class Undistortion:
    """The maps that resample a photograph.

    map_x, map_y [h,w] float32: the place of each pixel in the photograph, with pixel centres at 0 as in OpenCV.
    Undefined at invalid pixels.
    K [3,3]: the intrinsics of the pinhole camera, with pixel centres at +0.5 as everywhere in MGSR.
    valid_mask [h,w] bool: the pixels that the photograph covers; None means all.
    """

    map_x: np.ndarray
    map_y: np.ndarray
    K: np.ndarray
    valid_mask: np.ndarray | None = None


@dataclass(frozen=True)
class _DistortedImage:
    """The lens, K [3,3] and size in pixels of a photograph."""

    lens: AnyLens
    K: np.ndarray
    width: int
    height: int


@dataclass(frozen=True)
class _ImagePlane:
    """The part of the image plane that an image shows.

    left, top: its upper left corner, in pixels of the photograph. step: the size of its pixels, in the same unit.
    """

    left: float
    top: float
    width: int
    height: int
    step: float = 1.0


def undistortion(
    lens: AnyLens,
    K: np.ndarray,
    width: int,
    height: int,
    source: str,
    options: UndistortionOptions = UndistortionOptions(),
) -> Undistortion:
    """Compute the maps of a pinhole image with the focal lengths of the photograph.

    K [3,3]: the photograph's intrinsics in pixels.

    The image shows the photograph's field of view up to `options.half_angle`. If a rectangle holds nearly all of it,
    the image is that rectangle, as training then needs no mask. A pixel is valid if the lens projects its ray into the
    photograph, at an angle at which the lens's polynomial has not folded back. Raises SceneError naming `source` if no
    pixel is left.
    """
    photograph = _DistortedImage(lens, K, width, height)
    widest = math.tan(math.radians(options.half_angle))
    frame = _frame(photograph, widest, options)
    map_x, map_y = np.empty((2, frame.height, frame.width), np.float32)
    valid = np.empty((frame.height, frame.width), bool)
    for band in _bands(frame.height):
        map_x[band], map_y[band], valid[band] = _mapped(photograph, frame, widest, band)
    if not valid.all():
        valid = _around(K[:2, 2] - (frame.left, frame.top), valid)
    rows, cols = _kept(valid, options.rectangle)
    if rows.stop - rows.start < 2 or cols.stop - cols.start < 2:
        raise SceneError(f"{source}: the lens distortion {lens} leaves no usable pixels; check its parameters")
    pinhole = K.copy()
    pinhole[:2, 2] -= frame.left + cols.start, frame.top + rows.start
    map_x, map_y, valid = (np.ascontiguousarray(image[rows, cols]) for image in (map_x, map_y, valid))
    if valid.all():
        return Undistortion(map_x, map_y, pinhole)
    map_x[~valid] = map_y[~valid] = 0  # they may be NaN
    return Undistortion(map_x, map_y, pinhole, valid)


class Undistorter:
    """A thread-safe cache of undistortions, each computed once for all photographs of a camera.

    pixels: the store that holds the valid masks.
    """

    def __init__(self, pixels: PixelStore, options: UndistortionOptions = UndistortionOptions()) -> None:
        self._pixels, self._options = pixels, options
        self._lock = threading.Lock()
        self._made: dict[tuple[object, ...], Future[Undistortion]] = {}

    def __call__(self, lens: AnyLens, K: np.ndarray, width: int, height: int, source: str) -> Undistortion:
        """Return the result of `undistortion`, cached and shared between threads; errors are shared too."""
        key = (lens, K.tobytes(), width, height)
        with self._lock:
            mine = key not in self._made
            result = self._made.setdefault(key, Future())
            while len(self._made) > _KEPT:
                del self._made[next(iter(self._made))]
        if mine:
            try:
                result.set_result(self._held(undistortion(lens, K, width, height, source, self._options)))
            except Exception as error:  # waiting threads need the error too
                result.set_exception(error)
        return result.result()

    def _held(self, how: Undistortion) -> Undistortion:
        """Move `valid_mask` to the store, because views keep it longer than the maps."""
        if how.valid_mask is None:
            return how
        return replace(how, valid_mask=self._pixels.hold(how.valid_mask.view(np.uint8)).view(bool))


def resample(image: np.ndarray, how: Undistortion) -> np.ndarray:
    """Return the undistorted image [h,w,C] of a photograph `image` [H,W,C], by bicubic interpolation.

    Both are float32 or both uint8; in uint8, values are rounded.
    """
    import cv2  # imported here, because training needs no OpenCV

    # OpenCV interpolates floats in two thirds of the time of bytes.
    pixels = np.ascontiguousarray(image, np.float32)
    resampled = np.empty((*how.map_x.shape, image.shape[2]), image.dtype)
    for band in _bands(len(resampled)):
        x, y = how.map_x[band], how.map_y[band]
        sampled = cv2.remap(pixels, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        resampled[band] = (to_uint8(sampled) if image.dtype == np.uint8 else sampled).reshape(resampled[band].shape)
    return resampled


def _bands(height: int) -> Iterator[slice]:
    return (slice(start, min(start + _BAND, height)) for start in range(0, height, _BAND))


def _frame(photograph: _DistortedImage, widest: float, options: UndistortionOptions) -> _ImagePlane:
    """Return the part of the image plane that the photograph shows, in whole pixels, found on a coarse grid.

    widest: the tangent of the largest angle from the optical axis.
    """
    K = photograph.K
    lowest, highest = np.zeros(2), np.array([photograph.width, photograph.height])
    reach = np.maximum(K[:2, 2] - lowest, highest - K[:2, 2]) * options.max_growth
    reach = np.minimum(reach, widest * K.diagonal()[:2])
    step = max(1.0, float(reach.max()) * 2 / options.sketch)
    left, top = (K[:2, 2] - reach).tolist()
    width, height = np.ceil(2 * reach / step).astype(int).tolist()
    _, _, shown = _mapped(photograph, _ImagePlane(left, top, width, height, step), widest, slice(0, height))
    shown = _around((K[:2, 2] - (left, top)) / step, shown)
    rows, cols = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return _ImagePlane(0, 0, photograph.width, photograph.height)
    # The valid region may extend up to one grid cell beyond the last valid cell centre.
    first = np.floor([left + (cols[0] - 0.5) * step, top + (rows[0] - 0.5) * step])
    last = np.ceil([left + (cols[-1] + 1.5) * step, top + (rows[-1] + 1.5) * step])
    size = (last - first).astype(int).tolist()
    return _ImagePlane(*first.tolist(), *size)


def _mapped(photograph: _DistortedImage, frame: _ImagePlane, widest: float, rows: slice) -> tuple[np.ndarray, ...]:
    """Return map_x and map_y [rows,width] of an `Undistortion`, and the valid pixels [rows,width] bool.

    widest: the tangent of the largest angle from the optical axis.
    """
    K, width, height = photograph.K, photograph.width, photograph.height
    (fx, fy), (cx, cy) = K.diagonal()[:2].tolist(), K[:2, 2].tolist()
    # The border of one pixel is for `_unfolded`. float32 is precise to a thousandth of a pixel.
    x = ((frame.left - cx + (np.arange(-1, frame.width + 1) + 0.5) * frame.step) / fx).astype(np.float32)
    y = ((frame.top - cy + (np.arange(rows.start - 1, rows.stop + 1) + 0.5) * frame.step) / fy).astype(np.float32)
    with np.errstate(all="ignore"):  # invalid lens parameters leave no valid pixels, which is refused later
        bent_x, bent_y = photograph.lens.distort(x[None, :], y[:, None])
        map_x, map_y = bent_x * fx + (cx - 0.5), bent_y * fy + (cy - 0.5)
        inside = (map_x >= -0.5) & (map_x <= width - 0.5) & (map_y >= -0.5) & (map_y <= height - 0.5)
        shown = inside[1:-1, 1:-1] & _unfolded(map_x, map_y)
    if max(np.abs(x).max(), np.abs(y).max()) > widest / 2**0.5:
        shown &= (x**2)[None, 1:-1] + (y**2)[1:-1, None] <= widest**2
    return map_x[1:-1, 1:-1], map_y[1:-1, 1:-1], shown


def _unfolded(map_x: np.ndarray, map_y: np.ndarray) -> np.ndarray:
    """Return where the mapping [H,W] keeps its orientation, [H-2,W-2] bool, without the border."""
    turn = (map_x[1:-1, 2:] - map_x[1:-1, :-2]) * (map_y[2:, 1:-1] - map_y[:-2, 1:-1])
    shear = (map_x[2:, 1:-1] - map_x[:-2, 1:-1]) * (map_y[1:-1, 2:] - map_y[1:-1, :-2])
    kept: np.ndarray = turn > shear
    return kept


def _around(place: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the connected part of `shown` [H,W] bool that contains a place [2] in pixels.

    Far from the centre, a lens's polynomial folds back. Farther out it may fold again and show the photograph a second
    time with the right orientation; the result excludes such parts.
    """
    import cv2  # imported here, because training needs no OpenCV

    _, pieces = cv2.connectedComponents(shown.view(np.uint8), connectivity=4)
    row, col = min(int(place[1]), len(shown) - 1), min(int(place[0]), shown.shape[1] - 1)
    connected: np.ndarray = shown & (pieces == pieces[row, col])
    return connected


def _kept(valid: np.ndarray, share: float) -> tuple[slice, slice]:
    """Return the rows and columns of a rectangle of valid pixels [H,W] if it holds at least a share of them.

    Otherwise return the bounding box of all valid pixels.
    """
    rows, columns = largest_rectangle(valid)
    inner = valid[rows, columns]
    if inner.all() and inner.size >= share * valid.sum():
        return rows, columns
    along, across = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
    if not len(along):
        return slice(0, 0), slice(0, 0)
    return slice(int(along[0]), int(along[-1]) + 1), slice(int(across[0]), int(across[-1]) + 1)
