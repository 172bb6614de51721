"""Meshroom / AliceVision: a .sfm file (JSON) with poses, and the photographs.

Source: AliceVision's sfmDataIO (jsonIO.cpp, CHANGES.md, and the files of all versions in compatibilityData) and its
camera models. A pose is a world-to-camera rotation, written column by column, and the camera's centre, with OpenCV's
axes. Numbers are stored as strings, and empty lists as empty strings.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import read_json
from mgsr.data.lens import PANORAMA_CURE, AnyLens, FieldOfViewLens, Lens
from mgsr.data.number_lists import from_center, grey, numbers, point_cloud
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError

_POSES = re.compile(rb'"poses"\s*:\s*\[\s*\{')
_LANDMARKS = re.compile(rb'"structure"\s*:\s*\[\s*\{')
_JSON = ("sfm.json", "sfmData.json", "cameras.json")
_SENSOR_WIDTH = 36.0  # millimetres, if a file does not give it

# The first version of the files in which the focal length has two values; the origin of the principal point is the
# middle of the image; the focal length is in millimetres; pixelRatio is fy / fx, not fx / fy; the focal length is fy.
_TWO_FOCALS, _FROM_MIDDLE, _MILLIMETRES = (1, 2, 0), (1, 2, 1), (1, 2, 2)
_RATIO_OF_PIXELS, _FOCAL_OF_Y = (1, 2, 5), (1, 2, 11)

# The number of terms of each kind of distortion. In files before version 1.2.7, the camera's type gives the kind.
_TERMS = {"none": 0, "radialk1": 1, "radialk3": 3, "radialk3pt": 3, "brown": 5, "fisheye4": 4, "fisheye1": 1}
_BY_TYPE = {"pinhole": "none", "radial1": "radialk1", "radial3": "radialk3"} | {
    name: name for name in ("brown", "fisheye4", "fisheye1")
}
_UNDISTORT = "add a node ExportImages or PrepareDenseScene, and use its images with their .sfm file"


def recognises(root: Path) -> str | None:
    """Return the folder's first .sfm or .json file that has poses; files with landmarks come first."""
    names = [path.name for path in sorted(root.glob("[!.]*.sfm"))] + list(_JSON)
    found = [name for name in names if _has(root / name, _POSES)]
    return next((name for name in found if _has(root / name, _LANDMARKS)), found[0] if found else None)


def read(folder: SceneFolder) -> Capture:
    """Read every view that has a pose, and every landmark."""
    file = recognises(folder.root)
    assert file is not None, "read() accepts recognised folders only"
    scene = _scene(read_json(folder.root / file), file)
    found = folder.find_photos(file, [view.get("path") for view in scene.views])
    capture = Capture.of(
        found, lambda i, path: _photo(path, scene.views[i], scene, f"{file}, view {i} ({folder.shown(path)})")
    )
    return replace(capture, points=scene.points, least_kept=0.25)


@dataclass(frozen=True)
class _MeshroomScene:
    """The content of a file. intrinsics, poses, rigs: by their ids, as text."""

    version: tuple[int, ...]
    views: list[dict[str, Any]]
    intrinsics: dict[str, dict[str, Any]]
    poses: dict[str, dict[str, Any]]
    rigs: dict[str, dict[str, Any]]
    points: PointCloud | None


def _has(path: Path, part: re.Pattern[bytes]) -> bool:
    """Return whether AliceVision wrote a file and it contains `part`."""
    try:
        with path.open("rb") as file:
            if b'"version"' not in file.read(4096):
                return False
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                return part.search(content) is not None and content.find(b'"intrinsicId"') >= 0
    except (OSError, ValueError):
        return False


def _scene(content: Any, file: str) -> _MeshroomScene:
    if not isinstance(content, dict):
        raise SceneError(f"{file}: expected an object with views, intrinsics and poses; export it again")
    landmarks = _rows(content, "structure", file)
    colors = [landmark.get("color", grey(1)[0]) for landmark in landmarks]
    return _MeshroomScene(
        _version(content.get("version"), file),
        _rows(content, "views", file),
        {str(row.get("intrinsicId")): row for row in _rows(content, "intrinsics", file)},
        {str(row.get("poseId")): row for row in _rows(content, "poses", file)},
        {str(row.get("rigId")): row for row in _rows(content, "rigs", file)},
        point_cloud([landmark.get("X") for landmark in landmarks], colors),
    )


def _rows(content: Mapping[str, Any], part: str, file: str) -> list[dict[str, Any]]:
    rows = content.get(part) or []
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SceneError(f"{file}: {part}: expected a list of objects; export it again")
    return rows


def _version(value: Any, file: str) -> tuple[int, ...]:
    words = numbers(value, 3, "version", file)
    return tuple(int(word) for word in words)


def _photo(image: Path, view: dict[str, Any], scene: _MeshroomScene, source: str) -> Photo:
    camera = scene.intrinsics.get(str(view.get("intrinsicId")))
    if camera is None:
        raise SceneError(
            f"{source}: the file lacks its intrinsics {str(view.get('intrinsicId'))[:80]!r}; export it again"
        )
    pose = _pose(view, scene, source)
    K, lens, size = _camera(camera, scene.version, source)
    return Photo(image, K, size, pose, source, lens=None if lens is None or lens.flat else lens)


def _pose(view: dict[str, Any], scene: _MeshroomScene, source: str) -> np.ndarray:
    """Return cam_from_world [4,4] of a view: its own pose, or its place in a rig composed with the rig's pose.

    Raises SceneError if the view has no pose.
    """
    entry = scene.poses.get(str(view.get("poseId")))
    if entry is None:
        raise SceneError(f"{source}: it has no pose")
    pose = entry.get("pose")
    rig_from_world = _rigid(pose.get("transform") if isinstance(pose, dict) else None, source)
    if "rigId" not in view or str(view.get("isPoseIndependant", "true")).lower() in ("true", "1"):
        return rig_from_world
    view_from_world: np.ndarray = _place_in_rig(view, scene, source) @ rig_from_world
    return view_from_world


def _place_in_rig(view: dict[str, Any], scene: _MeshroomScene, source: str) -> np.ndarray:
    """Return cam_from_rig [4,4] of a view. Raises SceneError if the file lacks its place in the rig."""
    places = _rows(scene.rigs.get(str(view["rigId"]), {}), "subPoses", source)
    index = int(numbers([view.get("subPoseId")], 1, "subPoseId", source)[0])
    if not 0 <= index < len(places):
        raise SceneError(
            f"{source}: the file lacks its place {index} in rig {str(view['rigId'])[:80]}; export it again"
        )
    return _rigid(places[index].get("pose"), source)


def _rigid(value: Any, source: str) -> np.ndarray:
    """Return the pose [4,4] from an object with rotation and center. Raises SceneError for anything else."""
    if not isinstance(value, dict):
        raise SceneError(
            f"{source}: expected a pose with rotation and center, got {str(value)[:80]!r}; export it again"
        )
    columns = numbers(value.get("rotation"), 9, "rotation", source).reshape(3, 3)
    return from_center(columns.T, numbers(value.get("center"), 3, "center", source))


def _camera(
    camera: dict[str, Any], version: tuple[int, ...], source: str
) -> tuple[np.ndarray, AnyLens | None, tuple[int, int]]:
    """Return the intrinsics [3,3] in pixels, the lens, and the image size (width, height) of a camera.

    Raises SceneError for unsupported camera models.
    """
    width, height = (_one(camera, name, source) for name in ("width", "height"))
    cx, cy = numbers(camera.get("principalPoint"), 2, "principalPoint", source)
    if version >= _FROM_MIDDLE:
        cx, cy = cx + width / 2, cy + height / 2
    fx, fy = _focal_lengths(camera, version, width, source)
    lens, scale = _lens(camera, source)
    return intrinsics(fx * scale, fy * scale, cx, cy), lens, (int(width), int(height))


def _focal_lengths(camera: dict[str, Any], version: tuple[int, ...], width: float, source: str) -> tuple[float, float]:
    """Return fx and fy in pixels."""
    if version < _TWO_FOCALS:
        focal = _one(camera, "pxFocalLength", source)
        return focal, focal
    if version < _MILLIMETRES:
        fx, fy = numbers(camera.get("pxFocalLength"), 2, "pxFocalLength", source)
        return fx, fy
    ratio = _one(camera, "pixelRatio", source) if "pixelRatio" in camera else 1.0
    sensor = _one(camera, "sensorWidth", source) if "sensorWidth" in camera else _SENSOR_WIDTH
    if ratio <= 0 or sensor <= 0:
        raise SceneError(f"{source}: expected pixelRatio and sensorWidth above 0, got {ratio:g} and {sensor:g}")
    focal = _one(camera, "focalLength", source) / sensor * width
    if version >= _FOCAL_OF_Y:
        return focal / ratio, focal
    return focal, focal * ratio if version >= _RATIO_OF_PIXELS else focal / ratio


def _one(camera: dict[str, Any], name: str, source: str) -> float:
    return float(numbers([camera.get(name)], 1, name, source)[0])


def _lens(camera: dict[str, Any], source: str) -> tuple[AnyLens | None, float]:
    """Return the lens, and the factor that it applies to the focal length.

    Raises SceneError for unsupported distortions.
    """
    kind = _kind(camera, source)
    undone = camera.get("undistortionParams") or []
    if not isinstance(undone, list) or numbers(undone, len(undone), "undistortionParams", source).any():
        raise SceneError(f"{source}: its lens has undistortionParams, which MGSR does not read; {_UNDISTORT}")
    given = camera.get("distortionParams") or [0.0] * _TERMS[kind]
    k1, k2, k3, t1, t2 = *(float(x) for x in numbers(given, _TERMS[kind], "distortionParams", source)), *_zeros(kind)
    match kind:
        case "fisheye4":
            return Lens(k1, k2, higher=(k3, t1), fisheye=True), 1.0
        case "fisheye1":
            return FieldOfViewLens(k1) if k1 else None, 1.0
        case "radialk3pt":  # this model leaves a radius of 1 unchanged, so the focal length absorbs the sum
            total = 1 + k1 + k2 + k3
            if total <= 0:
                raise SceneError(f"{source}: distortionParams {given} fold the image over; {_UNDISTORT}")
            return Lens(k1, k2, higher=(k3,)), 1 / total
    return Lens(k1, k2, t1, t2, higher=(k3,)), 1.0


def _zeros(kind: str) -> list[float]:
    """Return zeros for the terms that a kind of distortion lacks."""
    return [0.0] * (5 - _TERMS[kind])


def _kind(camera: dict[str, Any], source: str) -> str:
    """Return the kind of distortion, one of _TERMS. Raises SceneError for other kinds."""
    camera_type = str(camera.get("type", "pinhole")).lower()
    if camera_type == "equirectangular":
        raise SceneError(f"{source}: camera type {camera_type} is not supported: {PANORAMA_CURE}")
    named = str(camera["distortionType"]).lower() if camera_type == "pinhole" and "distortionType" in camera else None
    kind = named or _BY_TYPE.get(camera_type)
    if kind not in _TERMS:
        what = f"camera type {camera_type[:80]!r}" if named is None else f"distortion {named[:80]!r}"
        raise SceneError(f"{source}: {what} is not supported; {_UNDISTORT}")
    return kind


FORMAT = Format("meshroom", "a .sfm with poses (Meshroom, AliceVision)", recognises, read, rank=110)
