"""OpenMVG: sfm_data.json with poses, and the photographs.

Source: OpenMVG's documentation, "sfm_data format", and its headers in cameras/ for the lens models. A pose is a
world-to-camera rotation and the camera's centre, with OpenCV's axes. Principal points are in pixels. An unknown one is
half the width and height, so the image spans 0 to its width.
"""

from __future__ import annotations

import mmap
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import number, read_json
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, Lens
from mgsr.data.number_lists import from_center, grey, matrix, numbers, point_cloud
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError

# cereal sets this bit in an object's number at its first occurrence. Later references have the number without it.
_FIRST_TIME = 0x80000000
# For each camera model: the name of its distortion terms in the file, and their number.
_TERMS = {
    "pinhole": ("", 0),
    "pinhole_radial_k1": ("disto_k1", 1),
    "pinhole_radial_k3": ("disto_k3", 3),
    "pinhole_brown_t2": ("disto_t2", 5),
    "fisheye": ("fisheye", 4),
}
_POSES = re.compile(rb'"extrinsics"\s*:\s*\[\s*\{')


def recognises(root: Path) -> str | None:
    """Return the folder's first .json file that OpenMVG wrote and that has poses."""
    return next((path.name for path in sorted(root.glob("[!.]*.json")) if _has_poses(path)), None)


def read(folder: SceneFolder) -> Capture:
    """Read every view that has a pose, and every point. The points are grey, as the file has no colours."""
    file = recognises(folder.root)
    assert file is not None, "read() accepts recognised folders only"
    scene = _scene(read_json(folder.root / file), file)
    names = [_path(scene.root_path, view) for view in scene.views]
    found = folder.find_photos(file, names)
    capture = Capture.of(found, lambda i, path: _photo(path, scene.views[i], scene, f"{file}, view {names[i]!s:.80}"))
    return replace(capture, points=scene.points, least_kept=0.25)


@dataclass(frozen=True)
class _OpenMvgScene:
    """The content of a file. intrinsics, poses: by their numbers."""

    root_path: str
    views: list[dict[str, Any]]
    intrinsics: dict[Any, dict[str, Any]]
    poses: dict[Any, dict[str, Any]]
    points: PointCloud | None


def _has_poses(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            if b'"sfm_data_version"' not in file.read(4096):
                return False
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                return _POSES.search(content) is not None
    except (OSError, ValueError):
        return False


def _scene(content: Any, file: str) -> _OpenMvgScene:
    if not isinstance(content, dict):
        raise SceneError(f"{file}: expected an object with views, intrinsics and extrinsics; export it again")
    pointers, models = _Pointers(), _Pointers()
    views = [pointers.resolve(value.get("ptr_wrapper"), "data") for _, value in _entries(content, "views", file)]
    cameras = {}
    for key, value in _entries(content, "intrinsics", file):
        model = models.resolve({"id": value.get("polymorphic_id"), **value}, "polymorphic_name")
        cameras[_id(key)] = {**_flat(pointers.resolve(value.get("ptr_wrapper"), "data")), "model": model}
    places = [value.get("X") for _, value in _entries(content, "structure", file)]
    return _OpenMvgScene(
        str(content.get("root_path") or ""),
        [_flat(view) for view in views],
        cameras,
        {_id(key): value for key, value in _entries(content, "extrinsics", file)},
        point_cloud(places, grey(len(places))),
    )


def _entries(content: dict[str, Any], part: str, file: str) -> list[tuple[Any, dict[str, Any]]]:
    """Return the keys and values of a map, which cereal writes as a list of objects with key and value.

    Raises SceneError for anything else.
    """
    rows = content.get(part) or []
    if not isinstance(rows, list) or not all(isinstance(x, dict) and isinstance(x.get("value"), dict) for x in rows):
        raise SceneError(f"{file}: {part}: expected a list of objects with 'key' and 'value'; export it again")
    return [(row.get("key"), row["value"]) for row in rows]


class _Pointers:
    """Objects that cereal writes once and then refers to by number."""

    def __init__(self) -> None:
        self._known: dict[int, Any] = {}

    def resolve(self, wrapper: Any, name: str) -> Any:
        """Return the wrapper's content, or the earlier content of the same number; None if there is neither."""
        if not isinstance(wrapper, dict):
            return None
        number = wrapper.get("id")
        content = wrapper.get(name)
        if not isinstance(number, int):
            return content
        if content is None:
            return self._known.get(number & ~_FIRST_TIME)
        self._known[number & ~_FIRST_TIME] = content
        return content


def _flat(data: Any) -> dict[str, Any]:
    """Merge an object with its base classes (value0 and so on), which some versions nest in it."""
    if not isinstance(data, dict):
        return {}
    bases = [value for name, value in data.items() if name.startswith("value") and isinstance(value, dict)]
    return {name: value for part in (*bases, data) for name, value in part.items()}


def _id(value: Any) -> Any:
    """Return a value if it is a whole number, else None, since other values may not be hashable."""
    return value if isinstance(value, int) else None


def _path(root_path: str, view: dict[str, Any]) -> Any:
    """Return the path of the view's photograph, or the file's entry as it is if it is not text."""
    name = view.get("filename")
    if not isinstance(name, str) or not root_path or re.match(r"/|[A-Za-z]:|\\", name):
        return name
    return f"{root_path}/{name}"


def _photo(image: Path, view: dict[str, Any], scene: _OpenMvgScene, source: str) -> Photo:
    pose = scene.poses.get(_id(view.get("id_pose")))
    camera = scene.intrinsics.get(_id(view.get("id_intrinsic")))
    if pose is None or camera is None:
        raise SceneError(f"{source}: {'it has no pose' if pose is None else 'the file lacks its intrinsics'}")
    K, lens = _camera(camera, source)
    rotation = matrix(pose.get("rotation"), "rotation", source)
    center = numbers(pose.get("center"), 3, "center", source)
    size = (int(number(camera, "width", source)), int(number(camera, "height", source)))
    return Photo(image, K, size, from_center(rotation, center), source, lens=lens)


def _camera(camera: dict[str, Any], source: str) -> tuple[np.ndarray, Lens | None]:
    """Return the intrinsics [3,3] in pixels, and the lens of a camera.

    Raises SceneError for unsupported camera models.
    """
    model = camera["model"]
    if model in PANORAMAS:
        raise SceneError(f"{source}: camera model {model} is not supported: {PANORAMA_CURE}")
    if not isinstance(model, str) or model not in _TERMS:
        raise SceneError(
            f"{source}: camera model {str(model)[:80]!r} is not supported; expected one of {', '.join(_TERMS)}; "
            "choose one of them in OpenMVG's image listing, or use the output of openMVG_main_ExportUndistortedImages"
        )
    focal = number(camera, "focal_length", source)
    cx, cy = numbers(camera.get("principal_point"), 2, "principal_point", source)
    name, count = _TERMS[model]
    lens = _lens(model, [float(term) for term in numbers(camera.get(name), count, name, source)] if count else [])
    return intrinsics(focal, focal, cx, cy), None if lens.flat else lens


def _lens(model: str, terms: list[float]) -> Lens:
    if model == "fisheye":
        return Lens(terms[0], terms[1], higher=tuple(terms[2:]), fisheye=True)
    k1, k2, k3, t1, t2 = (*terms, *[0.0] * (5 - len(terms)))
    return Lens(k1, k2, t1, t2, higher=(k3,))


FORMAT = Format("openmvg", "sfm_data.json with poses (OpenMVG)", recognises, read, rank=100)
