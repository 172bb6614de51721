"""Photographs resampled as a pinhole camera would have taken them."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from mgsr.data.lens import AnyLens
from mgsr.errors import SceneError

# The maps of a 2-megapixel camera take 16 MB; captures with a camera for each photograph must not pile them up.
_KEPT = 8


@dataclass(frozen=True)
class Undistortion:
    """How to resample one photograph: source pixel coordinates [h,w] for each pixel, and the pinhole's K."""

    source_x: np.ndarray
    source_y: np.ndarray
    K: np.ndarray


def undistortion(lens: AnyLens, K: np.ndarray, width: int, height: int, source: str) -> Undistortion:
    """The largest pinhole image with the photograph's focal lengths of which the photograph shows every pixel.

    Which pixels it shows is known exactly: those whose ray the lens puts inside the photograph, before the lens's
    polynomial folds back. The borders that it doesn't show are cut off, so that no part of MGSR meets pixels that
    nobody saw. Raises SceneError naming `source` if nothing is left.
    """
    # float32 places a pixel to a thousandth, and takes half the time of float64.
    x = ((np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]).astype(np.float32)
    y = ((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]).astype(np.float32)
    with np.errstate(all="ignore"):  # what a senseless lens makes is not seen, and so refused below
        bent_x, bent_y = lens.distort(x[None, :], y[:, None])
        source_x, source_y = bent_x * K[0, 0] + K[0, 2], bent_y * K[1, 1] + K[1, 2]
        seen = (source_x >= 0) & (source_x <= width) & (source_y >= 0) & (source_y <= height)
        rows, cols = _trim(seen & _unfolded(source_x, source_y))
    if rows.stop - rows.start < 2 or cols.stop - cols.start < 2:
        raise SceneError(f"{source}: the lens distortion {lens} leaves no usable image; check its numbers")
    pinhole = K.copy()
    pinhole[:2, 2] -= cols.start, rows.start
    return Undistortion(source_x[rows, cols], source_y[rows, cols], pinhole)


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

    # OpenCV counts from the middle of the first pixel.
    x, y = (np.asarray(source - 0.5, np.float32) for source in (how.source_x, how.source_y))
    sampled = cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return sampled.reshape(*x.shape, image.shape[2])


def _unfolded(source_x: np.ndarray, source_y: np.ndarray) -> np.ndarray:
    """Where the mapping keeps its orientation: polynomials fold back over themselves far from the centre."""
    turn = np.diff(source_x, axis=1)[1:] * np.diff(source_y, axis=0)[:, 1:]
    shear = np.diff(source_x, axis=0)[:, 1:] * np.diff(source_y, axis=1)[1:]
    return np.pad(turn > shear, ((1, 0), (1, 0)), mode="edge")


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
