"""The camera model that every part of MGSR uses: an undistorted pinhole with OpenCV axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    K: [3,3] float64, pixels; pixel centres at +0.5, so the image spans [0,width] x [0,height]. No skew;
    fx and fy may differ and the principal point may lie anywhere.
    cam_from_world: [4,4] float64, rigid, OpenCV axes (x right, y down, z forward).
    """

    K: np.ndarray
    cam_from_world: np.ndarray
    width: int
    height: int

    @cached_property
    def center(self) -> np.ndarray:
        """Return the camera's position [3] in the world; the array is read-only."""
        rotation, translation = self.cam_from_world[:3, :3], self.cam_from_world[:3, 3]
        center: np.ndarray = -rotation.T @ translation
        center.setflags(write=False)
        return center

    @property
    def world_from_cam(self) -> np.ndarray:
        """Return the inverse pose [4,4]."""
        pose = np.eye(4)
        pose[:3, :3] = self.cam_from_world[:3, :3].T
        pose[:3, 3] = self.center
        return pose

    def resized(self, width: int, height: int) -> Camera:
        """Return the same camera with its image sampled at another size."""
        K = self.K.copy()
        K[0] *= width / self.width
        K[1] *= height / self.height
        return replace(self, K=K, width=width, height=height)

    def scaled(self, factor: float, least: int = 1) -> Camera:
        """Return the same camera with its image's sides times a factor, rounded, each of `least` pixels or more."""
        return self.resized(max(least, round(self.width * factor)), max(least, round(self.height * factor)))

    def cropped(self, rows: slice, columns: slice) -> Camera:
        """Return the camera of a part of its image; both slices have a start and a stop inside the image."""
        K = self.K.copy()
        K[:2, 2] -= columns.start, rows.start
        return replace(self, K=K, width=columns.stop - columns.start, height=rows.stop - rows.start)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixel coordinates [P,2] and camera depths [P] of world points [P,3].

        Only points with a depth above 0 lie in front of the camera.
        """
        # Whole columns are faster than rows of three numbers.
        x, y, depth = self.cam_from_world[:3, :3] @ points.T + self.cam_from_world[:3, 3:]
        inverse = 1 / np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        pixels = np.empty((len(depth), 2))
        pixels[:, 0] = x * (self.K[0, 0] * inverse) + self.K[0, 2]
        pixels[:, 1] = y * (self.K[1, 1] * inverse) + self.K[1, 2]
        return pixels, depth

    def project_inside(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return which world points [P,3] lie before the camera and inside its image.

        Returns their indices [Q], pixel coordinates [Q,2] and camera depths [Q].
        """
        pixels, depths = self.project(points)
        x, y = pixels.T
        inside = (depths > 0) & (x >= 0) & (y >= 0) & (x < self.width) & (y < self.height)
        index = np.flatnonzero(inside)
        return index, pixels[index], depths[index]


def pinhole_row(camera: Camera) -> np.ndarray:
    """Return a camera as kernels read it, [16] float64.

    The values are fx, fy, cx, cy, then the pose's rotation, row by row, and its translation.
    """
    K, pose = camera.K, camera.cam_from_world
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *pose[:3, :3].ravel(), *pose[:3, 3]])


def pixel_size(cameras: Sequence[Camera], place: np.ndarray) -> float:
    """Return a pixel's size at a place [3] in the world, in the world's unit: the median over the cameras."""
    return float(np.median([np.linalg.norm(camera.center - place) / camera.K[0, 0] for camera in cameras]))
