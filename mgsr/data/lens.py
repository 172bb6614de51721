"""Lens distortion, and photographs resampled as a pinhole camera would have taken them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mgsr.errors import SceneError


@dataclass(frozen=True)
class Lens:
    """Radial (k1, k2) and tangential (p1, p2) distortion of OpenCV's model, on coordinates over depth."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def flat(self) -> bool:
        """Whether this lens changes nothing."""
        return self == Lens()

    def distort(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the lens puts the points (x, y, 1): OpenCV's calib3d documentation, "Detailed Description"."""
        r2 = x * x + y * y
        radial = 1 + self.k1 * r2 + self.k2 * r2 * r2
        dx = 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        dy = self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return x * radial + dx, y * radial + dy


@dataclass(frozen=True)
class Undistortion:
    """How to resample one photograph: source pixel coordinates [h,w] for each pixel, and the pinhole's K."""

    source_x: np.ndarray
    source_y: np.ndarray
    K: np.ndarray


def undistortion(lens: Lens, K: np.ndarray, width: int, height: int, source: str) -> Undistortion:
    """The largest pinhole image with the photograph's focal lengths of which the photograph shows every pixel.

    The borders that it doesn't show are cut off, so that no part of MGSR meets pixels that nobody saw.
    Raises SceneError naming `source` if nothing is left.
    """
    # float32 places a pixel to a thousandth, and takes half the time of float64.
    x = ((np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]).astype(np.float32)
    y = ((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]).astype(np.float32)
    bent_x, bent_y = lens.distort(x[None, :], y[:, None])
    source_x, source_y = bent_x * K[0, 0] + K[0, 2], bent_y * K[1, 1] + K[1, 2]
    seen = (source_x >= 0) & (source_x <= width) & (source_y >= 0) & (source_y <= height)
    rows, cols = _trim(seen & _unfolded(source_x, source_y))
    if rows.stop - rows.start < 2 or cols.stop - cols.start < 2:
        raise SceneError(f"{source}: the lens distortion {lens} leaves no usable image; check its numbers")
    pinhole = K.copy()
    pinhole[:2, 2] -= cols.start, rows.start
    return Undistortion(source_x[rows, cols], source_y[rows, cols], pinhole)


def resample(image: np.ndarray, how: Undistortion) -> np.ndarray:
    """The undistorted image [h,w,C] float32 of a photograph [H,W,C] float32, by bicubic interpolation."""
    height, width = image.shape[:2]
    grid = np.stack([how.source_x * (2 / width) - 1, how.source_y * (2 / height) - 1], axis=-1)
    # scipy.ndimage's cubic spline gives the same to a grey level and takes ten times as long.
    sampled = torch.nn.functional.grid_sample(
        torch.from_numpy(image).permute(2, 0, 1)[None],
        torch.from_numpy(grid.astype(np.float32))[None],
        mode="bicubic",
        padding_mode="border",
        align_corners=False,
    )
    return np.ascontiguousarray(sampled[0].permute(1, 2, 0).numpy())


def _unfolded(source_x: np.ndarray, source_y: np.ndarray) -> np.ndarray:
    """Where the mapping keeps its orientation: polynomials fold back over themselves far from the centre."""
    turn = np.diff(source_x, axis=1)[1:] * np.diff(source_y, axis=0)[:, 1:]
    shear = np.diff(source_x, axis=0)[:, 1:] * np.diff(source_y, axis=1)[1:]
    return np.pad(turn > shear, ((1, 0), (1, 0)), mode="edge")


def _trim(good: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of a large rectangle with a border of good pixels: the worst side is cut until all are."""
    top, bottom, left, right = 0, good.shape[0], 0, good.shape[1]
    while bottom - top > 1 and right - left > 1:
        inner = good[top:bottom, left:right]
        bad = [1 - side.mean() for side in (inner[0], inner[-1], inner[:, 0], inner[:, -1])]
        worst = int(np.argmax(bad))
        if bad[worst] == 0:
            break
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return slice(top, bottom), slice(left, right)
