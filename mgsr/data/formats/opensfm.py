"""OpenSfM and OpenDroneMap: reconstruction.json, or opensfm/reconstruction.json, and the photographs in images/.

Source: OpenSfM's documentation, "Reconstruction file format", "Coordinate Systems" and "Camera Models".
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import images_below, number, read_json
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, Lens
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics, matrix_from
from mgsr.data.registration import check_share
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError

_PLACES = ("reconstruction.json", "opensfm/reconstruction.json")
_PERSPECTIVE = ("perspective", "simple_radial", "radial", "brown")
_FISHEYE = ("fisheye", "fisheye_opencv", "fisheye62")


def recognises(root: Path) -> str | None:
    """Return the path of reconstruction.json, where OpenSfM or OpenDroneMap puts it, or None."""
    return next((place for place in _PLACES if (root / place).is_file()), None)


def read(folder: SceneFolder) -> Capture:
    """Read the photographs and points of the largest reconstruction, in its frame.

    The frame is in metres with z up if OpenSfM could determine them.
    """
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    largest = _largest(read_json(folder.root / name), name)
    shots, cameras = largest["shots"], largest["cameras"]
    names = sorted(shots)
    found = folder.find_photos(name, names, ("images",))
    capture = Capture.of(found, lambda i, path: _photo(path, shots[names[i]], cameras, f"{name}, shot {names[i][:80]}"))
    cure = "take more photographs between the unaligned ones, or remove those"
    total = max(len(images_below(folder.root / "images")), len(names))
    notes = check_share(len(names), total, 0.25, f"are in the largest reconstruction of {name}", cure)
    return replace(capture, points=_points(largest.get("points"), name), notes=(*capture.notes, *notes))


def _largest(content: Any, name: str) -> dict[str, Any]:
    parts = content if isinstance(content, list) else []
    good = [part for part in parts if isinstance(part, dict) and _maps(part.get("cameras"), part.get("shots"))]
    if not good:
        raise SceneError(f"{name}: expected a list of reconstructions with 'cameras' and 'shots'; export it again")
    return max(good, key=lambda part: len(part["shots"]))


def _maps(*values: Any) -> bool:
    """Return whether all values are dictionaries of dictionaries."""
    return all(isinstance(value, dict) and all(isinstance(x, dict) for x in value.values()) for value in values)


def _photo(image: Path, shot: dict[str, Any], cameras: dict[str, Any], source: str) -> Photo:
    camera = cameras.get(str(shot.get("camera")))
    if camera is None:
        raise SceneError(f"{source}: the file lacks camera {str(shot.get('camera'))[:80]!r}; export it again")
    size = (int(number(camera, "width", source)), int(number(camera, "height", source)))
    K, lens = _camera(camera, size, source)
    pose = np.eye(4)
    axis = matrix_from([shot.get("rotation")], 1, 3, "rotation", source)[0]
    pose[:3, 3] = matrix_from([shot.get("translation")], 1, 3, "translation", source)[0]
    if not np.isfinite(axis).all():
        raise SceneError(f"{source}: the rotation has NaN or infinite numbers; fix or remove this shot")
    pose[:3, :3] = Rotation.from_rotvec(axis).as_matrix()
    return Photo(image, K, size, pose, source, lens=lens)


def _camera(camera: dict[str, Any], size: tuple[int, int], source: str) -> tuple[np.ndarray, Lens | None]:
    """Return K [3,3] in pixels, and the lens of a camera. Raises SceneError for unsupported projections.

    The file's lengths are in units of the image's larger side. Its principal point is relative to the middle.
    """
    kind = str(camera.get("projection_type"))
    if kind in PANORAMAS:
        raise SceneError(f"{source}: projection_type {kind!r} is not supported: {PANORAMA_CURE}")
    if kind not in _PERSPECTIVE + _FISHEYE:
        known = ", ".join(_PERSPECTIVE + _FISHEYE)
        raise SceneError(f"{source}: projection_type {kind[:80]!r} is not supported; expected one of {known}")
    unit = max(size)
    fx, fy = (number(camera, axis if axis in camera else "focal", source) for axis in ("focal_x", "focal_y"))
    cx, cy = (number(camera, axis, source) if axis in camera else 0.0 for axis in ("c_x", "c_y"))
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    k1, k2, p1, p2, *higher = (number(camera, name, source) if name in camera else 0.0 for name in names)
    lens = Lens(k1, k2, p1, p2, tuple(higher), fisheye=kind in _FISHEYE)
    K = intrinsics(fx * unit, fy * unit, size[0] / 2 + cx * unit, size[1] / 2 + cy * unit)
    return K, None if lens.flat else lens


def _points(points: Any, name: str) -> PointCloud | None:
    if not points or not _maps(points):
        return None
    rows = list(points.values())
    positions = matrix_from([row.get("coordinates") for row in rows], len(rows), 3, "coordinates of points", name)
    colors = matrix_from([row.get("color", (128, 128, 128)) for row in rows], len(rows), 3, "color of points", name)
    finite = np.isfinite(positions).all(axis=1)
    return PointCloud(positions[finite], np.clip(np.nan_to_num(colors[finite]), 0, 255).astype(np.uint8))


FORMAT = Format("opensfm", f"{_PLACES[0]} and images/ (OpenSfM, OpenDroneMap)", recognises, read, rank=80)
