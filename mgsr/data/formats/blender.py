"""Blender / NeRF-synthetic: transforms_train.json and transforms_test.json with camera-to-world poses, OpenGL axes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import find_image, find_mask, read_json
from mgsr.data.images import image_size
from mgsr.data.lens import Lens
from mgsr.data.poses import from_opengl, intrinsics, matrix_from
from mgsr.errors import SceneError

_TRAIN, _TEST, _VAL = "transforms_train.json", "transforms_test.json", "transforms_val.json"


def recognises(root: Path) -> str | None:
    """transforms_train.json, if the folder has it."""
    return _TRAIN if (root / _TRAIN).is_file() else None


def read(root: Path) -> Capture:
    """All training and test frames. The validation frames are the test where there is no other, else unused."""
    test = next((name for name in (_TEST, _VAL) if (root / name).is_file()), None)
    train = _read_frames(root, _TRAIN, Split.TRAIN if test else None)
    return Capture(train + (_read_frames(root, test, Split.TEST) if test else []))


def _read_frames(root: Path, name: str, split: Split | None) -> list[Photo]:
    content = read_json(root / name)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise SceneError(f"{name}: expected an object with a list 'frames'")
    return [_read_frame(root, f"{name}, frame {i}", {**content, **frame}, split) for i, frame in enumerate(frames)]


def _read_frame(root: Path, source: str, frame: dict[str, Any], split: Split | None) -> Photo:
    """`frame` has the file's own values too, where the frame doesn't overrule them."""
    image = find_image(root, frame.get("file_path"), source)
    source = f"{source} ({image.relative_to(root)})"
    pose = matrix_from(frame.get("transform_matrix"), 4, 4, "transform_matrix", source)
    size = _size(frame, image, source)
    return Photo(
        image=image,
        K=_intrinsics(frame, size, source),
        size=size,
        cam_from_world=from_opengl(pose, source),
        source=source,
        mask=find_mask(root, image),
        split=split,
        lens=_lens(frame, source),
    )


def _size(frame: dict[str, Any], image: Path, source: str) -> tuple[int, int]:
    if "w" in frame and "h" in frame:
        return int(_number(frame, "w", source)), int(_number(frame, "h", source))
    return image_size(image, source)


def _intrinsics(frame: dict[str, Any], size: tuple[int, int], source: str) -> np.ndarray:
    """Focal lengths in pixels where given, else from the angle of view; the other axis has the same focal length."""
    fx = _focal(frame, "fl_x", "camera_angle_x", size[0], source)
    fy = _focal(frame, "fl_y", "camera_angle_y", size[1], source)
    if fx is None and fy is None:
        raise SceneError(f"{source}: no focal length; expected camera_angle_x (radians) or fl_x (pixels)")
    cx = _number(frame, "cx", source) if "cx" in frame else size[0] / 2
    cy = _number(frame, "cy", source) if "cy" in frame else size[1] / 2
    return intrinsics(fy if fx is None else fx, fx if fy is None else fy, cx, cy)  # type: ignore[arg-type]


def _focal(frame: dict[str, Any], pixels: str, angle: str, side: int, source: str) -> float | None:
    if pixels in frame:
        return _number(frame, pixels, source)
    if angle not in frame:
        return None
    value = _number(frame, angle, source)
    if not 0 < value < math.pi:
        raise SceneError(f"{source}: {angle}: expected an angle between 0 and pi radians, got {value:g}")
    return side / 2 / math.tan(value / 2)


def _lens(frame: dict[str, Any], source: str) -> Lens | None:
    for name in ("k3", "k4", "k5", "k6"):
        if name in frame and _number(frame, name, source) != 0:
            raise SceneError(f"{source}: distortion {name} is not supported; undistort the images first")
    lens = Lens(*(_number(frame, name, source) if name in frame else 0.0 for name in ("k1", "k2", "p1", "p2")))
    return None if lens.flat else lens


def _number(frame: dict[str, Any], name: str, source: str) -> float:
    value = frame[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise SceneError(f"{source}: {name}: expected a number, got {value!r}")
    return float(value)


FORMAT = Format("blender", f"{_TRAIN} (Blender, NeRF-synthetic)", recognises, read, rank=20)
