"""Read the frames of transforms*.json, which Blender, instant-ngp and nerfstudio write.

Poses map the camera to the world, with OpenGL's axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Photo, Split
from mgsr.data.files import number, read_json
from mgsr.data.images import image_size
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, Lens
from mgsr.data.photo_files import SceneFolder, reduction
from mgsr.data.poses import from_opengl, intrinsics, pose_from
from mgsr.errors import SceneError

_PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
_ANGLES = ("camera_angle_x", "camera_angle_y")
_FOCAL_LENGTHS = ("fl_x", "fl_y", *_ANGLES)


def read_content(path: Path) -> dict[str, Any]:
    """Read a file. Raises SceneError if it has no list of frames."""
    content = read_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise SceneError(f"{path.name}: expected an object with a list 'frames'; export it again")
    # An empty frame names no photograph, so only the invalid entry is skipped, not the file.
    return {**content, "frames": [frame if isinstance(frame, dict) else {} for frame in frames]}


def merged_frames(content: dict[str, Any], name: str) -> list[tuple[str, dict[str, Any]]]:
    """Return each frame's place in the file, for messages, and its values merged with the shared ones.

    A frame's values override the file's. A frame's angle of view also overrides the file's focal lengths.
    """
    shared = {key: value for key, value in content.items() if key != "frames"}
    without = {key: value for key, value in shared.items() if key not in _FOCAL_LENGTHS}
    frames = enumerate(content["frames"])
    return [(f"{name}, frame {i}", {**(without if _has_angle(frame) else shared), **frame}) for i, frame in frames]


def _has_angle(frame: dict[str, Any]) -> bool:
    return any(angle in frame for angle in _ANGLES)


def refuse_doubles(photos: Sequence[Photo]) -> None:
    """Raise SceneError if two frames share a photograph, which would count twice, or both for training and test."""
    first: dict[Path, Photo] = {}
    for photo in photos:
        other = first.setdefault(photo.image, photo)
        if other is not photo:
            raise SceneError(
                f"{photo.source}: this frame has the same photograph as {other.source}; remove one of them"
            )


@dataclass(frozen=True)
class Frame:
    """A frame. source: its place in the file, for messages. values: its values, merged with the shared ones."""

    source: str
    values: dict[str, Any]
    split: Split | None


def read_frames(folder: SceneFolder, file: str, frames: Sequence[Frame]) -> Capture:
    """Read the photographs of frames, whose paths are relative to the scene's root."""
    found = folder.find_photos(file, [frame.values.get("file_path") for frame in frames])
    return Capture.of(found, lambda i, path: _read_frame(folder, path, frames[i]))


def _read_frame(folder: SceneFolder, image: Path, frame: Frame) -> Photo:
    source, values = f"{frame.source} ({folder.shown(image)})", frame.values
    size = _size(values, image, source)
    return Photo(
        image=image,
        K=_intrinsics(values, size, source),
        size=size,
        cam_from_world=from_opengl(pose_from(values.get("transform_matrix"), "transform_matrix", source), source),
        source=source,
        mask=_mask(folder, values, source),
        split=frame.split,
        lens=_lens(values, source),
    )


def _mask(folder: SceneFolder, frame: dict[str, Any], source: str) -> Path | None:
    name = frame.get("mask_path")
    if not name:
        return None
    if (mask := folder.find_file(name, f"{source}, mask_path")) is None:
        raise SceneError(f"{source}: its mask {str(name)[:200]} is missing; add it, or name no mask")
    return mask


def _size(frame: dict[str, Any], image: Path, source: str) -> tuple[int, int]:
    """Return the size (width, height) of the calibrated image.

    Without w and h it is the photograph's size. If the photograph comes from a folder of reduced copies that the file
    does not name, its size is multiplied by the reduction.
    """
    if "w" in frame and "h" in frame:
        return int(number(frame, "w", source)), int(number(frame, "h", source))
    width, height = image_size(image, source)
    named = PurePosixPath(str(frame.get("file_path", "")).replace("\\", "/")).parent.name
    factor = reduction(image.parent.name) if image.parent.name != named else 1
    return width * factor, height * factor


def _intrinsics(frame: dict[str, Any], size: tuple[int, int], source: str) -> np.ndarray:
    """Return K [3,3] in pixels from focal lengths, or else from angles of view.

    An axis without either takes the focal length of the other axis. Raises SceneError if neither has one.
    """
    fx = _focal(frame, "fl_x", "camera_angle_x", size[0], source)
    fy = _focal(frame, "fl_y", "camera_angle_y", size[1], source)
    if fx is None and fy is None:
        raise SceneError(f"{source}: expected camera_angle_x (radians) or fl_x (pixels), got no focal length")
    cx = number(frame, "cx", source) if "cx" in frame else size[0] / 2
    cy = number(frame, "cy", source) if "cy" in frame else size[1] / 2
    return intrinsics(fy if fx is None else fx, fx if fy is None else fy, cx, cy)  # type: ignore[arg-type]


def _focal(frame: dict[str, Any], pixels: str, angle: str, side: int, source: str) -> float | None:
    if pixels in frame:
        return number(frame, pixels, source)
    if angle not in frame:
        return None
    value = number(frame, angle, source)
    if not 0 < value < math.pi:
        raise SceneError(f"{source}: {angle}: expected an angle between 0 and pi radians, got {value:g}; fix the file")
    return side / 2 / math.tan(value / 2)


def _lens(frame: dict[str, Any], source: str) -> Lens | None:
    """Return the frame's lens, or None if it has no distortion.

    OpenCV's fisheye model has four radial terms. For other lenses, nerfstudio defines k3 and k4 as the factors of r^6
    and r^8. Raises SceneError for unsupported camera models and terms.
    """
    model = str(frame.get("camera_model", "OPENCV")).upper()
    if model.lower() in PANORAMAS or frame.get("is_latlong"):
        raise SceneError(f"{source}: camera_model {model} is not supported: {PANORAMA_CURE}")
    if model not in _PERSPECTIVE + _FISHEYE or "ftheta_p0" in frame:
        raise SceneError(
            f"{source}: camera_model {model} is not supported; expected one of {', '.join(_PERSPECTIVE + _FISHEYE)}; "
            "undistort the images to pinhole cameras"
        )
    for name in ("k5", "k6"):
        if name in frame and number(frame, name, source) != 0:
            raise SceneError(f"{source}: distortion {name} is not supported; undistort the images first")
    names = ("k1", "k2", "p1", "p2", "k3", "k4")
    k1, k2, p1, p2, k3, k4 = (number(frame, name, source) if name in frame else 0.0 for name in names)
    lens = Lens(k1, k2, p1, p2, (k3, k4), fisheye=model in _FISHEYE or bool(frame.get("is_fisheye")))
    return None if lens.flat else lens
