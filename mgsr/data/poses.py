"""Checks of poses and intrinsics, and the change from OpenGL's axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from mgsr.errors import SceneError

# Rounding of what people write (four digits) passes; a scaled or sheared matrix does not.
RIGID_TOLERANCE = 2e-3
SKEW_TOLERANCE = 1e-6

# Pixels; and focal lengths in larger sides of the image. No camera lies beyond these.
LARGEST_SIDE = 1_000_000
LEAST_FOCAL, LARGEST_FOCAL = 0.003, 3000.0


def matrix_from(value: Any, rows: int, cols: int, what: str, source: str) -> np.ndarray:
    """A nested list as a float64 matrix of that size. Raises SceneError with `source` and `what`."""
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{source}: {what}: expected a {rows}x{cols} matrix of numbers; mend the file") from error
    if matrix.shape != (rows, cols):
        raise SceneError(
            f"{source}: {what}: expected a {rows}x{cols} matrix, got shape {list(matrix.shape)}; mend the file"
        )
    return matrix


def check_pose(matrix: np.ndarray, source: str) -> np.ndarray:
    """The rigid transform [4,4] with its rounding removed. Raises SceneError if it isn't one."""
    if not np.isfinite(matrix).all():
        raise SceneError(f"{source}: the pose has NaN or infinite numbers; remove this view or mend its pose")
    rotation = matrix[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > RIGID_TOLERANCE or np.abs(matrix[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise SceneError(
            f"{source}: the pose is not rigid (rotation off by {error:.2g}, last row {matrix[3].tolist()}); "
            "expected a rotation and a translation, without scale or shear"
        )
    if np.linalg.det(rotation) < 0:
        raise SceneError(f"{source}: the pose mirrors space (determinant -1); expected a rotation: check the axes")
    left, _, right = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3] = left @ right
    pose[:3, 3] = matrix[:3, 3]
    return pose


def check_intrinsics(K: np.ndarray, size: tuple[int, int], source: str) -> np.ndarray:
    """The intrinsics [3,3] for an image of `size`, scaled to a last row of 0 0 1. Raises SceneError if no pinhole
    camera has them, or its principal point lies outside the image."""
    if not np.isfinite(K).all():
        raise SceneError(f"{source}: the intrinsics have NaN or infinite numbers; remove this view or mend them")
    if not all(1 <= side <= LARGEST_SIDE for side in size):
        raise SceneError(
            f"{source}: an image of {size[0]:g}x{size[1]:g} pixels; expected sides from 1 to {LARGEST_SIDE}"
        )
    if K[0, 0] == 0 or K[1, 1] == 0:
        raise SceneError(f"{source}: the focal length is zero; expected fx and fy in pixels")
    if abs(np.linalg.det(K)) < 1e-9 * abs(K[0, 0] * K[1, 1]):
        raise SceneError(f"{source}: the intrinsics are singular: {K.tolist()}; expected [[fx,0,cx],[0,fy,cy],[0,0,1]]")
    K = K / K[2, 2] if K[2, 2] else K
    if np.abs(K[2] - [0, 0, 1]).max() > 1e-9 or abs(K[1, 0]) > SKEW_TOLERANCE * abs(K[1, 1]):
        raise SceneError(f"{source}: expected intrinsics [[fx,0,cx],[0,fy,cy],[0,0,1]], got {K.tolist()}")
    if abs(K[0, 1]) > SKEW_TOLERANCE * abs(K[0, 0]):
        raise SceneError(f"{source}: the intrinsics have skew ({K[0, 1]:g}); resample the images without skew first")
    if K[0, 0] < 0 or K[1, 1] < 0:
        raise SceneError(f"{source}: the focal length is negative; expected fx and fy in pixels, with OpenCV axes")
    if not all(LEAST_FOCAL <= focal / max(size) <= LARGEST_FOCAL for focal in K.diagonal()[:2]):
        raise SceneError(
            f"{source}: focal lengths of {K[0, 0]:g} and {K[1, 1]:g} pixels in an image of {size[0]}x{size[1]}; "
            f"expected {LEAST_FOCAL:g} to {LARGEST_FOCAL:g} times its larger side"
        )
    if not (0 <= K[0, 2] <= size[0] and 0 <= K[1, 2] <= size[1]):
        raise SceneError(
            f"{source}: the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies outside the image of {size[0]}x{size[1]} "
            "pixels; expected cx and cy in pixels of it: give the images that were calibrated, not parts of them"
        )
    return np.array([[K[0, 0], 0, K[0, 2]], [0, K[1, 1], K[1, 2]], [0, 0, 1]])


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """K [3,3] from focal lengths and principal point, pixels."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)


def from_opengl(world_from_cam: np.ndarray, source: str) -> np.ndarray:
    """cam_from_world [4,4] with OpenCV axes from a camera-to-world pose with OpenGL axes (y up, z backward)."""
    pose = check_pose(world_from_cam, source)
    rotation = pose[:3, :3] * [1, -1, -1]
    result = np.eye(4)
    result[:3, :3] = rotation.T
    result[:3, 3] = -rotation.T @ pose[:3, 3]
    return result
