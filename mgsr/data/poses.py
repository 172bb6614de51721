"""Check poses and intrinsics, and convert poses from OpenGL's axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from mgsr.errors import SceneError

# Matrices rounded to four digits pass; scaled or sheared ones do not.
RIGID_TOLERANCE = 2e-3
SKEW_TOLERANCE = 1e-6

# Pixels; and focal lengths in larger sides of the image. No camera lies beyond these.
LARGEST_SIDE = 1_000_000
LEAST_FOCAL, LARGEST_FOCAL = 0.003, 3000.0
# The largest distance of the principal point from the image's middle, in focal lengths. A crop of a larger image may
# lie beside the optical axis, but not more than about 80 degrees from it.
FARTHEST_PRINCIPAL_POINT = 5.0


def matrix_from(value: Any, rows: int, cols: int, what: str, source: str) -> np.ndarray:
    """Return a nested list as a float64 matrix [rows,cols]. Raises SceneError with `source` and `what`."""
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"{source}: {what}: expected a {rows}x{cols} matrix of numbers; fix the file") from error
    if matrix.shape != (rows, cols):
        raise SceneError(
            f"{source}: {what}: expected a {rows}x{cols} matrix, got shape {list(matrix.shape)}; fix the file"
        )
    return matrix


def pose_from(value: Any, what: str, source: str) -> np.ndarray:
    """Return the pose [4,4] of a nested list of 3 or 4 rows of 4 numbers, or of those numbers in one list.

    Raises SceneError with `source` and `what` for anything else.
    """
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"{source}: {what}: expected a 4x4 or 3x4 matrix of numbers; fix the file") from error
    if matrix.shape in ((12,), (16,)):
        matrix = matrix.reshape(-1, 4)
    if matrix.shape == (3, 4):
        return np.vstack([matrix, [0.0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise SceneError(
            f"{source}: {what}: expected a 4x4 or 3x4 matrix, got shape {list(matrix.shape)}; fix the file"
        )
    return matrix


def split_pose(matrix: np.ndarray, source: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Return rotation [3,3], translation [3] and uniform scale of a pose [4,4].

    The pose maps x to scale rotation x + translation. The rotation is exact, without rounding. The scale is 1 where it
    differs from 1 by rounding alone.

    Raises SceneError for a matrix with NaN, with shear, with unequal scales of its axes, or that mirrors space.
    """
    if not np.isfinite(matrix).all():
        raise SceneError(f"{source}: the pose has NaN or infinite numbers; fix it, or export the poses again")
    if not matrix[3].any():
        matrix = np.vstack([matrix[:3], [0.0, 0, 0, 1]])
    if np.abs(matrix[3, :3]).max() > 0 and not matrix[:3, 3].any():
        raise SceneError(f"{source}: the pose has its translation in the last row; transpose the matrix")
    with np.errstate(all="ignore"):  # what overflows is refused
        matrix = matrix / matrix[3, 3] if matrix[3, 3] else matrix
        linear = matrix[:3, :3]
        determinant = float(np.linalg.det(linear))
        scale = abs(determinant) ** (1 / 3)
        error = np.abs(linear @ linear.T / max(scale, 1e-150) ** 2 - np.eye(3)).max()
    if not error <= RIGID_TOLERANCE or np.abs(matrix[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise SceneError(
            f"{source}: expected a rotation and a translation, got a pose that is not rigid (rotation off by "
            f"{error:.2g}, last row {matrix[3].tolist()}). Its three axes must be orthogonal and equally long. Divide "
            "each axis of a look-at matrix by its length. In Blender, apply unequal scales of the object and its "
            "parents (Ctrl+A) before the export"
        )
    if determinant < 0:
        raise SceneError(f"{source}: expected a rotation, got a reflection (determinant -1); check the axes")
    left, _, right = np.linalg.svd(linear)
    return left @ right, matrix[:3, 3], 1.0 if abs(scale - 1) <= RIGID_TOLERANCE else scale


def check_pose(matrix: np.ndarray, source: str) -> np.ndarray:
    """Return the rigid transform [4,4] of a cam_from_world pose, without rounding and without its uniform scale.

    The scaled pose projects every point to the same pixel. Raises SceneError as `split_pose`.
    """
    rotation, translation, scale = split_pose(matrix, source)
    with np.errstate(over="ignore"):  # what overflows is refused
        translation = translation / scale
    if not np.isfinite(translation).all():
        raise SceneError(f"{source}: the translation is too large for the pose's scale of {scale:.3g}; fix the pose")
    return rigid(rotation, translation)


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the pose [4,4] of a rotation [3,3] and a translation [3]."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def check_intrinsics(K: np.ndarray, size: tuple[int, int], source: str) -> np.ndarray:
    """Return the intrinsics [3,3] for an image of `size`, scaled to a last row of 0 0 1.

    The principal point may lie outside the image, as after a crop. Raises SceneError for intrinsics that no pinhole
    camera has.
    """
    if not np.isfinite(K).all():
        raise SceneError(
            f"{source}: the intrinsics have NaN or infinite numbers; fix them, or export the cameras again"
        )
    if not all(1 <= side <= LARGEST_SIDE for side in size):
        raise SceneError(f"{source}: expected image sides from 1 to {LARGEST_SIDE} pixels, got {size[0]:g}x{size[1]:g}")
    if K[0, 0] == 0 or K[1, 1] == 0:
        raise SceneError(f"{source}: expected fx and fy in pixels, got a focal length of zero")
    with np.errstate(all="ignore"):  # what overflows is refused
        determinant, product = abs(np.linalg.det(K)), abs(K[0, 0] * K[1, 1])
    if determinant < 1e-9 * product:
        raise SceneError(
            f"{source}: expected intrinsics [[fx,0,cx],[0,fy,cy],[0,0,1]], got the singular matrix {K.tolist()}"
        )
    with np.errstate(over="ignore"):
        K = K / K[2, 2] if K[2, 2] else K
    if np.abs(K[2] - [0, 0, 1]).max() > 1e-9 or abs(K[1, 0]) > SKEW_TOLERANCE * abs(K[1, 1]):
        raise SceneError(f"{source}: expected intrinsics [[fx,0,cx],[0,fy,cy],[0,0,1]], got {K.tolist()}")
    if abs(K[0, 1]) > SKEW_TOLERANCE * abs(K[0, 0]):
        raise SceneError(f"{source}: the intrinsics have skew ({K[0, 1]:g}); resample the images without skew first")
    if K[0, 0] < 0 or K[1, 1] < 0:
        raise SceneError(f"{source}: expected fx and fy in pixels with OpenCV axes, got a negative focal length")
    if not all(LEAST_FOCAL <= focal / max(size) <= LARGEST_FOCAL for focal in K.diagonal()[:2]):
        raise SceneError(
            f"{source}: expected focal lengths of {LEAST_FOCAL:g} to {LARGEST_FOCAL:g} times the larger image side, "
            f"got {K[0, 0]:g} and {K[1, 1]:g} pixels in an image of {size[0]}x{size[1]}"
        )
    with np.errstate(over="ignore"):  # what overflows is refused
        beside = np.abs(K[:2, 2] - np.array(size) / 2) / K.diagonal()[:2]
    if beside.max() > FARTHEST_PRINCIPAL_POINT:
        raise SceneError(
            f"{source}: the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies {beside.max():.3g} focal lengths from the "
            f"centre of the image of {size[0]}x{size[1]} pixels, expected at most {FARTHEST_PRINCIPAL_POINT:g}; write "
            "cx and cy in pixels of this image"
        )
    return np.array([[K[0, 0], 0, K[0, 2]], [0, K[1, 1], K[1, 2]], [0, 0, 1]])


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Return K [3,3] of focal lengths and principal point, pixels."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)


def cuts_out(K: np.ndarray, size: tuple[int, int]) -> bool:
    """Return whether the principal point of K [3,3] lies outside an image of `size`, as after a crop."""
    return not (0 <= K[0, 2] <= size[0] and 0 <= K[1, 2] <= size[1])


def from_world_from_cam(world_from_cam: np.ndarray, source: str) -> np.ndarray:
    """Return cam_from_world [4,4] of a camera-to-world pose [4,4], both with OpenCV's axes.

    A uniform scale is kept, as its inverse. Raises SceneError as `split_pose`.
    """
    return _inverse(*split_pose(world_from_cam, source))


def from_opengl(world_from_cam: np.ndarray, source: str) -> np.ndarray:
    """Return cam_from_world [4,4], OpenCV axes, of a camera-to-world pose [4,4] with OpenGL axes (y up, z backward).

    A uniform scale is kept, as its inverse. Raises SceneError as `split_pose`.
    """
    rotation, center, scale = split_pose(world_from_cam, source)
    return _inverse(rotation * [1, -1, -1], center, scale)


def _inverse(rotation: np.ndarray, center: np.ndarray, scale: float) -> np.ndarray:
    """Return the inverse pose [4,4] of a rotation [3,3], a centre [3] and a scale."""
    pose = rigid(rotation.T, -rotation.T @ center)
    pose[:3] /= scale
    return pose
