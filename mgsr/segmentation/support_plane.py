"""Detection of the plane that an object stands on, by RANSAC (Fischler and Bolles 1981)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import SupportPlaneOptions
from mgsr.data.camera import Camera


@dataclass(frozen=True)
class SupportPlane:
    """The plane of the points x with normal . x + offset = 0.

    normal [3]: a unit vector in the world frame that points upwards, to the object's side. offset: in the world's unit.
    """

    normal: np.ndarray
    offset: float

    @property
    def coefficients(self) -> np.ndarray:
        """Return the normal and the offset in one array, [4]."""
        return np.append(self.normal, self.offset)

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Return the signed heights [P] of points [P,3] above the plane, in the world's unit."""
        return np.asarray(points @ self.normal + self.offset)

    def depth(self, center: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return the camera z [H,W] at which a camera's rays meet the plane, infinite where they do not.

        center [3]: the camera's centre in the world frame. rays [H,W,3]: see `pixel_rays`.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -self.heights(center[None])[0] / (rays @ self.normal)
        return np.where((depth > 0) & np.isfinite(depth), depth, np.inf)


def upward(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the cameras' mean upward direction [3], a unit vector in the world frame."""
    mean = -np.mean([camera.cam_from_world[1, :3] for camera in cameras], axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-12))


def find_support_plane(
    points: np.ndarray,
    cameras: Sequence[Camera],
    tolerance: float,
    generator: np.random.Generator,
    options: SupportPlaneOptions = SupportPlaneOptions(),
) -> SupportPlane | None:
    """Find the plane under an object, given points [P,3] of the object and its surroundings in the world frame.

    The plane is nearly level and lies below the cameras. Many points lie within `tolerance` of it, in the world's unit,
    and few lie below it. Returns None if no plane meets these conditions. The same generator state gives the same
    plane.
    """
    if len(points) < 3:
        return None
    best = _most_supported(points, upward(cameras), tolerance, generator, options)
    if best is None:
        return None
    for _ in range(options.refits):
        near = points[np.abs(best.heights(points)) < tolerance]
        if len(near) < 3:
            return None
        best = _fitted(near, best.normal)
    heights = best.heights(points)
    supported = (np.abs(heights) < tolerance).mean() >= options.min_inliers
    lowest = (heights < -2 * tolerance).mean() <= options.max_below
    seen_from_above = np.mean([best.heights(camera.center[None])[0] > 0 for camera in cameras]) >= options.min_above
    return best if supported and lowest and seen_from_above else None


def _most_supported(
    points: np.ndarray,
    up: np.ndarray,
    tolerance: float,
    generator: np.random.Generator,
    options: SupportPlaneOptions,
) -> SupportPlane | None:
    """Return the best of many planes, each through three of the points [P,3]; None if none of them is level.

    up [3]: the upward direction, unit. A plane's score is a truncated quadratic of the points' heights (MSAC);
    tolerance: where it is cut off, in the points' unit.
    """
    corners = points[generator.integers(0, len(points), (options.trials, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(lengths, 1e-12)[:, None]
    normals *= np.where(normals @ up < 0, -1.0, 1.0)[:, None]
    level = np.flatnonzero((lengths > 1e-9) & (normals @ up > np.cos(np.radians(options.max_tilt))))
    best, most = None, 0.0
    for index in level:
        plane = SupportPlane(normals[index], float(-normals[index] @ corners[index, 0]))
        support = float(np.clip(1 - (plane.heights(points) / tolerance) ** 2, 0, 1).sum())
        if support > most:
            best, most = plane, support
    return best


def _fitted(points: np.ndarray, normal: np.ndarray) -> SupportPlane:
    """Fit a plane to points [P,3] by least squares, and orient it along `normal` [3]."""
    middle = points.mean(axis=0)
    found = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    found = found * (1.0 if found @ normal >= 0 else -1.0)
    return SupportPlane(found, float(-found @ middle))
