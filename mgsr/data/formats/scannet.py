"""ScanNet as its SensReader exports it: color/*.jpg, pose/*.txt and intrinsic/intrinsic_color.txt.

Source: ScanNet (ScanNet/ScanNet), SensReader/python. Poses map the camera to the world, with OpenCV's axes. Frames
without tracking have -inf.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.images import image_size
from mgsr.data.number_files import read_intrinsics, read_pose, texts_in
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_world_from_cam
from mgsr.errors import SceneError

_INTRINSICS = (
    *("intrinsic/intrinsic_color.txt", "intrinsics/intrinsic_color.txt", "intrinsic_color.txt"),
    *("intrinsics_color.txt", "intrinsic/intrinsics_color.txt"),
)
_PLACES = ("color", "rgb", "images", ".")
_FULL = (1296, 968)  # the size of ScanNet's photographs, which are often reduced to 640x480
_LEAST_KEPT = 0.1  # low, because ScanNet often loses tracking, and the other frames are good nevertheless


def recognises(root: Path) -> str | None:
    """Return the file of the photographs' intrinsics if pose/ has poses."""
    name = next((name for name in _INTRINSICS if (root / name).is_file()), None)
    return name if name and texts_in(root / "pose") else None


def read(folder: SceneFolder) -> Capture:
    """Read every frame that has a pose."""
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    K, _ = read_intrinsics(folder.root / name)
    poses = texts_in(folder.root / "pose")
    found = folder.find_photos("pose/", [path.stem for path in poses], _PLACES, labels=True)
    capture = Capture.of(found, lambda i, image: _photo(image, K, poses[i]))
    return replace(capture, least_kept=_LEAST_KEPT)


def _photo(image: Path, K: np.ndarray, file: Path) -> Photo:
    source = f"pose/{file.name}"
    pose = read_pose(file)
    if not np.isfinite(pose).all():
        raise SceneError(f"{source}: the frame has no pose, because tracking was lost")
    size = image_size(image, source)
    return Photo(image, _for_size(K, size), size, from_world_from_cam(pose, source), source)


def _for_size(K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the intrinsics [3,3] in pixels for a photograph of `size`, with pixel centres at +0.5.

    ScanNet's principal point is the middle of the image, computed for a larger image with pixel centres at 0. A point
    within a pixel of the middle is therefore taken as the middle. Any other principal point has pixel centres at 0, as
    in ScanNet's programs.
    """
    middle = np.array(size) / 2
    if np.abs(K[:2, 2] - middle).max() <= 1:
        return _with_center(K, middle)
    full = np.array(_FULL)
    if np.abs(K[:2, 2] - full / 2).max() <= 1:
        scaled = K.copy()
        scaled[:2] *= (np.array(size) / full)[:, None]
        return _with_center(scaled, middle)
    return _with_center(K, K[:2, 2] + 0.5)


def _with_center(K: np.ndarray, center: np.ndarray) -> np.ndarray:
    moved = K.copy()
    moved[:2, 2] = center
    return moved


FORMAT = Format("scannet", "color/, pose/ and intrinsic/intrinsic_color.txt (ScanNet)", recognises, read, rank=160)
