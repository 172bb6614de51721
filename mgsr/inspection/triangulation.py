"""Triangulation of points from several photographs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.data.camera import Camera


def unit_rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the unit directions [N,3] in the world of a camera's pixels [N,2]."""
    local = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T
    rays = local @ camera.cam_from_world[:3, :3]
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def nearest_points(origins: np.ndarray, rays: np.ndarray, of_point: np.ndarray, count: int) -> np.ndarray:
    """Return the points [P,3] nearest to their rays, by least squares.

    origins, rays [O,3]: unit directions; of_point [O]: the point that each ray belongs to, below `count`.
    """
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    left, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(left, of_point, across)
    np.add.at(right, of_point, np.einsum("oij,oj->oi", across, origins))
    left += 1e-9 * np.eye(3)  # parallel rays make the matrix singular
    return np.asarray(np.linalg.solve(left, right[..., None])[..., 0])


def spread(cameras: Sequence[Camera], pixels: Sequence[np.ndarray]) -> float:
    """Return how well pixels [N,2] of several photographs, which show the same N points, fit the cameras.

    For each photograph, the median distance of the triangulated points from their pixels is computed, in pixels. The
    result is the largest of these medians.
    """
    count = len(pixels[0])
    rays = np.concatenate([unit_rays(*pair) for pair in zip(cameras, pixels, strict=True)])
    origins = np.repeat([camera.center for camera in cameras], count, axis=0)
    points = nearest_points(origins, rays, np.tile(np.arange(count), len(cameras)), count)
    off = [camera.project(points)[0] - places for camera, places in zip(cameras, pixels, strict=True)]
    return float(np.median(np.linalg.norm(off, axis=2), axis=1).max())
