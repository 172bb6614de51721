"""The output folder of 3D Gaussian Splatting: cameras.json, beside cfg_args and point_cloud/.

Source: the reference implementation (graphdeco-inria/gaussian-splatting, utils/camera_utils.py, camera_to_JSON).
Position and rotation map the camera to the world, with OpenCV's axes. The principal point is the middle of the image.
Forks and successors write the same file, some with cx and cy.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import number, read_json
from mgsr.data.number_files import head_of
from mgsr.data.number_lists import matrix, numbers
from mgsr.data.photo_files import SceneFolder
from mgsr.data.pointclouds import read_points
from mgsr.data.poses import from_world_from_cam, intrinsics, rigid
from mgsr.data.scene import PointCloud
from mgsr.errors import MissingPhotoError, SceneError

_FILE = "cameras.json"
_POINTS = "input.ply"  # the points with which training began
_KEYS = (b'"position"', b'"rotation"', b'"fx"', b'"img_name"')
_RENDERS = re.compile(r"ours_\d+")  # a folder of renders; their numbers may match the names of photographs


def recognises(root: Path) -> str | None:
    """Return cameras.json if it is a list of cameras of this form. Other programs write files of that name too."""
    head = head_of(root / _FILE).lstrip(b"\xef\xbb\xbf \t\r\n")
    return _FILE if head.startswith(b"[") and all(key in head for key in _KEYS) else None


def read(folder: SceneFolder) -> Capture:
    """Read every camera, and find the photographs by name below the scene's folder.

    The source path in cfg_args is not followed. Raises SceneError if no photograph is found.
    """
    cameras = read_json(folder.root / _FILE)
    if not isinstance(cameras, list) or not cameras or not all(isinstance(camera, dict) for camera in cameras):
        raise SceneError(f"{_FILE}: expected a list of cameras; copy it again")
    names = [str(camera.get("img_name", "")) for camera in cameras]
    found = folder.find_photos(_FILE, names, ("images", "input", "."), labels=True)
    capture = Capture.of(found, lambda i, path: _photo(folder, path, cameras[i], names[i], f"{_FILE}, camera {i}"))
    if not capture.photos and len(capture.missing) == len(names):
        raise SceneError(_without_photographs(folder.root, names))
    points, notes = _points(folder.root)
    return replace(capture, points=points, notes=(*capture.notes, *notes))


def _without_photographs(root: Path, names: list[str]) -> str:
    source = re.search(rb"source_path='([^']{1,200})'", head_of(root / "cfg_args"))
    trained_on = f" (it was trained on {source[1].decode(errors='replace')})" if source else ""
    return (
        f"{_FILE}: this file has the cameras of 3D Gaussian Splatting, but its {len(names)} photographs are not in "
        f"this folder ({names[0][:80]}...){trained_on}; copy them to images/ beside {_FILE}, or use the folder that "
        "it was trained on"
    )


def _photo(folder: SceneFolder, image: Path, camera: dict[str, Any], name: str, source: str) -> Photo:
    if any(_RENDERS.fullmatch(part) for part in image.relative_to(folder.top).parts):
        raise MissingPhotoError(f"{name[:80]} is missing")
    width, height = number(camera, "width", source), number(camera, "height", source)
    K = intrinsics(
        number(camera, "fx", source),
        number(camera, "fy", source),
        number(camera, "cx", source) if "cx" in camera else width / 2,
        number(camera, "cy", source) if "cy" in camera else height / 2,
    )
    rotation = matrix(camera.get("rotation"), "rotation", source)
    position = numbers(camera.get("position"), 3, "position", source)
    pose = from_world_from_cam(rigid(rotation, position), source)
    return Photo(image, K, (round(width), round(height)), pose, source)


def _points(root: Path) -> tuple[PointCloud | None, tuple[str, ...]]:
    """Return the points with which training began, or a note if they can't be read."""
    if not (root / _POINTS).is_file():
        return None, ()
    try:
        return read_points(root / _POINTS), ()
    except SceneError as error:
        return None, (f"the points are ignored: {error}",)


FORMAT = Format("gaussians", f"{_FILE} of 3D Gaussian Splatting, with its photographs", recognises, read, rank=130)
