"""Record3D (iPhone and iPad): metadata.json of an "EXR + JPG" export, or metadata of an unpacked .r3d file.

A pose is qx qy qz qw tx ty tz, from the camera to the world, with OpenGL's axes. K is stored by columns. Source: the
author's answers in the app's repository (marek-simonik/record3d, issues 27, 33, 36 and 64).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import number, read_json
from mgsr.data.images import image_size
from mgsr.data.number_files import LARGEST_CAPTURE, head_of, photographs_in
from mgsr.data.number_lists import numbers, rotation_of
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_opengl, intrinsics, rigid
from mgsr.errors import SceneError

_FILES = ("metadata.json", "metadata")
_PLACES = ("rgb", "rgbd", "EXR_RGBD/rgb", "images", ".")


def recognises(root: Path) -> str | None:
    """Return metadata.json or metadata if it has "K" and "poses". Other programs write files of these names too."""
    return next((name for name in _FILES if _is_record3d(root / name)), None)


def _is_record3d(path: Path) -> bool:
    if not path.is_file() or not head_of(path, 64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        return False
    content = head_of(path, LARGEST_CAPTURE)
    return b'"poses"' in content and b'"K"' in content


def read(folder: SceneFolder) -> Capture:
    """Read every frame, with its photograph by number and its own intrinsics if the file has them.

    Raises SceneError if the file has no poses.
    """
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    content = read_json(folder.root / name)
    poses = content.get("poses") if isinstance(content, dict) else None
    if not isinstance(poses, list) or not poses:
        raise SceneError(
            f"{name}: the file has no poses; record with the LiDAR camera, because videos of the front camera have "
            "none, and export again"
        )
    found = folder.find_photos(name, _names(folder.root, len(poses)), _PLACES)
    return Capture.of(found, lambda frame, path: _photo(path, content, poses[frame], frame, f"{name}, frame {frame}"))


def _names(root: Path, count: int) -> list[str]:
    """Return the photographs of the frames. The folder numbers them 0.jpg or 000000.jpg, from 0 or from 1."""
    for place in _PLACES:
        found = {int(path.stem): path for path in photographs_in(root / place) if re.fullmatch(r"\d{1,9}", path.stem)}
        if found:
            first = 1 if 0 not in found and count in found else 0
            names = [found.get(i + first) for i in range(count)]
            return [str(path.relative_to(root)) if path else f"{i + first}.jpg" for i, path in enumerate(names)]
    return [f"{i}.jpg" for i in range(count)]


def _photo(image: Path, content: dict[str, Any], pose: Any, frame: int, source: str) -> Photo:
    return Photo(
        image=image,
        K=_intrinsics(content, frame, source),
        size=_size(content, image, source),
        cam_from_world=_cam_from_world(numbers(pose, 7, "pose", source), source),
        source=source,
    )


def _intrinsics(content: dict[str, Any], frame: int, source: str) -> np.ndarray:
    """Return K [3,3] in pixels from the frame's fx fy cx cy, or else from the file's K.

    The origin of ARKit's pixel coordinates is the upper left corner of the image.
    """
    frames = content.get("perFrameIntrinsicCoeffs")
    if isinstance(frames, list) and frame < len(frames):
        return intrinsics(*numbers(frames[frame], 4, "perFrameIntrinsicCoeffs", source))
    K = numbers(content.get("K"), 9, "K", source).reshape(3, 3)
    return K if K[:2, 2].any() else K.T


def _size(content: dict[str, Any], image: Path, source: str) -> tuple[int, int]:
    if content.get("w") is None or content.get("h") is None:
        return image_size(image, source)
    return round(number(content, "w", source)), round(number(content, "h", source))


def _cam_from_world(pose: np.ndarray, source: str) -> np.ndarray:
    """Return cam_from_world [4,4] from qx qy qz qw tx ty tz.

    Raises SceneError for a zero quaternion, which the app writes for frames without a pose.
    """
    return from_opengl(rigid(rotation_of(np.roll(pose[:4], 1), source), pose[4:]), source)


FORMAT = Format("record3d", "metadata.json with K and poses (Record3D)", recognises, read, rank=100)
