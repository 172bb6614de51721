"""Photographs resampled as a pinhole camera would have taken them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from mgsr.data.images import to_uint8
from mgsr.data.lens import AnyLens
from mgsr.errors import SceneError

# The maps of a 2-megapixel camera take 16 MB; captures with a camera for each photograph must not pile them up.
_KEPT = 8

# Rows that are worked at a time, so that all that is in work stays in the processor's cache: making maps takes an
# eighth of the time of whole images.
_BAND = 32


@dataclass(frozen=True)
class Undistortion:
    """How to resample one photograph: for each pixel its place there, map_x and map_y [h,w] float32, counted from the
    middle of the first pixel as OpenCV does; and the pinhole's K, counted from the corner as everywhere in MGSR."""

    map_x: np.ndarray
    map_y: np.ndarray
    K: np.ndarray


def undistortion(lens: AnyLens, K: np.ndarray, width: int, height: int, source: str) -> Undistortion:
    """The largest pinhole image, in the photograph's frame and with its focal lengths, of which it shows every pixel.

    Which pixels it shows is known exactly: those whose ray the lens puts inside the photograph, before its polynomial
    folds back. The borders that it doesn't show are cut off, so that no part of MGSR meets pixels that nobody saw.
    Raises SceneError naming `source` if nothing is left.
    """
    map_x, map_y = np.empty((2, height, width), np.float32)
    shown = np.empty((height, width), bool)
    for band in _bands(height):
        map_x[band], map_y[band], shown[band] = _mapped(lens, K, width, height, band)
    rows, cols = _trim(shown if shown.all() else _around(K[:2, 2], shown))
    if rows.stop - rows.start < 2 or cols.stop - cols.start < 2:
        raise SceneError(f"{source}: the lens distortion {lens} leaves no usable image; check its numbers")
    pinhole = K.copy()
    pinhole[:2, 2] -= cols.start, rows.start
    return Undistortion(np.ascontiguousarray(map_x[rows, cols]), np.ascontiguousarray(map_y[rows, cols]), pinhole)


class Undistorter:
    """Undistortions, each made once for all photographs of a camera. For many threads at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._made: dict[tuple[object, ...], Future[Undistortion]] = {}

    def __call__(self, lens: AnyLens, K: np.ndarray, width: int, height: int, source: str) -> Undistortion:
        """As `undistortion`."""
        key = (lens, K.tobytes(), width, height)
        with self._lock:
            mine = key not in self._made
            result = self._made.setdefault(key, Future())
            while len(self._made) > _KEPT:
                del self._made[next(iter(self._made))]
        if mine:
            try:
                result.set_result(undistortion(lens, K, width, height, source))
            except Exception as error:  # those who wait for it need the error too
                result.set_exception(error)
        return result.result()


def resample(image: np.ndarray, how: Undistortion) -> np.ndarray:
    """The undistorted image [h,w,C] of a photograph [H,W,C], float32 or uint8 (rounded), by bicubic interpolation."""
    import cv2  # late: training needs no OpenCV

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


def _mapped(lens: AnyLens, K: np.ndarray, width: int, height: int, rows: slice) -> tuple[np.ndarray, ...]:
    """map_x, map_y [rows,width] of an `Undistortion`, and which of these pixels the photograph shows."""
    (fx, fy), (cx, cy) = K.diagonal()[:2].tolist(), K[:2, 2].tolist()
    # With a border of one pixel, to see folds. float32 places a pixel to a thousandth.
    x = ((np.arange(-1, width + 1) + (0.5 - cx)) / fx).astype(np.float32)
    y = ((np.arange(rows.start - 1, rows.stop + 1) + (0.5 - cy)) / fy).astype(np.float32)
    with np.errstate(all="ignore"):  # what a senseless lens makes is not shown, and so refused
        bent_x, bent_y = lens.distort(x[None, :], y[:, None])
        map_x, map_y = bent_x * fx + (cx - 0.5), bent_y * fy + (cy - 0.5)
        inside = (map_x >= -0.5) & (map_x <= width - 0.5) & (map_y >= -0.5) & (map_y <= height - 0.5)
        shown = inside[1:-1, 1:-1] & _unfolded(map_x, map_y)
    return map_x[1:-1, 1:-1], map_y[1:-1, 1:-1], shown


def _unfolded(map_x: np.ndarray, map_y: np.ndarray) -> np.ndarray:
    """Where the mapping keeps its orientation, without the border."""
    turn = (map_x[1:-1, 2:] - map_x[1:-1, :-2]) * (map_y[2:, 1:-1] - map_y[:-2, 1:-1])
    shear = (map_x[2:, 1:-1] - map_x[:-2, 1:-1]) * (map_y[1:-1, 2:] - map_y[1:-1, :-2])
    return turn > shear


def _around(place: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """What is shown in one piece with a place [2], pixels. Far from the centre polynomials fold back over themselves,
    and farther out may do so again: there they show the photograph a second time, with the right orientation."""
    import cv2  # late: training needs no OpenCV

    _, pieces = cv2.connectedComponents(shown.view(np.uint8), connectivity=4)
    row, col = min(int(place[1]), len(shown) - 1), min(int(place[0]), shown.shape[1] - 1)
    return shown & (pieces == pieces[row, col])


def _trim(good: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of a large rectangle of good pixels: the worst side is cut until the border is good, and then
    all sides, should bad pixels lie inside."""
    top, bottom, left, right = 0, good.shape[0], 0, good.shape[1]
    while bottom - top > 1 and right - left > 1:
        inner = good[top:bottom, left:right]
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
