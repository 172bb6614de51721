"""Polycam's raw data: keyframes/ with a JSON for each photograph, camera-to-world, ARKit's axes (OpenGL's).

Source: the README of Polycam's polyform.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import find_image, number, read_json
from mgsr.data.poses import from_opengl, intrinsics
from mgsr.errors import SceneError

# With the poses that Polycam optimised, where it did; else those of the session.
_PLACES = (("keyframes/corrected_cameras", "keyframes/corrected_images"), ("keyframes/cameras", "keyframes/images"))
_CAMERAS = "[!.]*.json"


def recognises(root: Path) -> str | None:
    """The folder of cameras, if it and its images are there."""
    there = (place for place, images in _PLACES if (root / images).is_dir() and any((root / place).glob(_CAMERAS)))
    return next(there, None)


def read(root: Path) -> Capture:
    """Every camera's photograph, in Polycam's frame: metres, y up."""
    place = recognises(root)
    assert place is not None, "read() is for folders that were recognised"
    images = dict(_PLACES)[place]
    return Capture([_photo(root, path, images) for path in sorted((root / place).glob(_CAMERAS))])


def _photo(root: Path, path: Path, images: str) -> Photo:
    source = path.relative_to(root).as_posix()
    camera = read_json(path)
    if not isinstance(camera, dict):
        raise SceneError(f"{source}: expected an object with fx, fy, cx, cy and t_00 to t_23")
    pose = np.eye(4)
    pose[:3] = [[number(camera, f"t_{row}{col}", source) for col in range(4)] for row in range(3)]
    image = find_image(root, f"{images}/{path.stem}", source)
    return Photo(
        image=image,
        K=intrinsics(*(number(camera, name, source) for name in ("fx", "fy", "cx", "cy"))),
        size=(int(number(camera, "width", source)), int(number(camera, "height", source))),
        cam_from_world=from_opengl(pose, source),
        source=source,
    )


FORMAT = Format("polycam", "keyframes/cameras and keyframes/images (Polycam's raw data)", recognises, read, rank=70)
