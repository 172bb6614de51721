"""Polycam's raw data: keyframes/ with a JSON file for each photograph.

Poses map the camera to the world, with ARKit's axes, which are OpenGL's. Source: the README of Polycam's polyform.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import number, read_json
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_opengl, intrinsics
from mgsr.errors import SceneError

# The poses that Polycam optimised come first, then the poses of the recording session.
_PLACES = (("keyframes/corrected_cameras", "keyframes/corrected_images"), ("keyframes/cameras", "keyframes/images"))
_CAMERAS = "[!.]*.json"


def recognises(root: Path) -> str | None:
    """Return the first folder of cameras that exists together with its images, or None."""
    there = (place for place, images in _PLACES if (root / images).is_dir() and any((root / place).glob(_CAMERAS)))
    return next(there, None)


def read(folder: SceneFolder) -> Capture:
    """Read every camera and its photograph, in Polycam's frame: metres, y up."""
    place = recognises(folder.root)
    assert place is not None, "read() accepts recognised folders only"
    files = sorted((folder.root / place).glob(_CAMERAS))
    found = folder.find_photos(place, [path.stem for path in files], (dict(_PLACES)[place],))
    return Capture.of(found, lambda i, path: _photo(path, files[i], files[i].relative_to(folder.root).as_posix()))


def _photo(image: Path, path: Path, source: str) -> Photo:
    camera = read_json(path)
    if not isinstance(camera, dict):
        raise SceneError(f"{source}: expected an object with fx, fy, cx, cy and t_00 to t_23")
    pose = np.eye(4)
    pose[:3] = [[number(camera, f"t_{row}{col}", source) for col in range(4)] for row in range(3)]
    return Photo(
        image=image,
        K=intrinsics(*(number(camera, name, source) for name in ("fx", "fy", "cx", "cy"))),
        size=(int(number(camera, "width", source)), int(number(camera, "height", source))),
        cam_from_world=from_opengl(pose, source),
        source=source,
    )


FORMAT = Format("polycam", "keyframes/cameras and keyframes/images (Polycam's raw data)", recognises, read, rank=70)
