"""nerfstudio and instant-ngp: one transforms.json with camera-to-world poses, OpenGL axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import number
from mgsr.data.photo_files import SceneFolder
from mgsr.data.pointclouds import read_points
from mgsr.data.poses import matrix_from, rigid, split_pose
from mgsr.data.scene import PointCloud
from mgsr.data.transforms import Frame, merged_frames, read_content, read_frames, refuse_doubles
from mgsr.errors import SceneError

_FILE = "transforms.json"


def recognises(root: Path) -> str | None:
    """Return transforms.json if the folder has it."""
    return _FILE if (root / _FILE).is_file() else None


def read(folder: SceneFolder) -> Capture:
    """Read every frame, in the world frame before `applied_transform` and `applied_scale`.

    The file's own split is used if it names one, and the points of `ply_file_path`. Raises SceneError if two frames
    share a photograph.
    """
    content = read_content(folder.root / _FILE)
    splits = _splits(content)
    frames = [Frame(source, values, _split(values, splits)) for source, values in merged_frames(content, _FILE)]
    capture = read_frames(folder, _FILE, frames)
    refuse_doubles(capture.photos)
    undo = _Applied(content)
    points, notes = _points(folder, content)
    photos = [undo.photo(photo) for photo in capture.photos]
    return replace(capture, photos=photos, points=undo.points(points), notes=(*capture.notes, *notes))


def _points(folder: SceneFolder, content: dict[str, Any]) -> tuple[PointCloud | None, tuple[str, ...]]:
    """Return the points that the file names, or a note that they are missing."""
    name = content.get("ply_file_path")
    if not name:
        return None, ()
    path = folder.find_file(name, f"{_FILE}, ply_file_path")
    if path is not None:
        return read_points(path), ()
    return None, (f"the points {str(name)[:80]} named by {_FILE} are missing; the run starts without them",)


def _splits(content: dict[str, Any]) -> dict[str, Split]:
    """Return the split of each listed name. Validation frames serve as test frames if there are no others.

    Raises SceneError if a name is in two lists, or an entry is not a list.
    """
    lists = {part: content.get(f"{part}_filenames") for part in ("train", "val", "test")}
    if not all(names is None or isinstance(names, list) for names in lists.values()):
        raise SceneError(f"{_FILE}: expected train_filenames, val_filenames and test_filenames to be lists of paths")
    part = "test" if lists["test"] else "val"
    train, tests = ([_key(name) for name in lists[name] or []] for name in ("train", part))
    if both := set(train) & set(tests):
        raise SceneError(
            f"{_FILE}: {min(both)[:200]} is in both train_filenames and {part}_filenames; remove it from one of them"
        )
    return dict.fromkeys(train, Split.TRAIN) | dict.fromkeys(tests, Split.TEST) if tests else {}


def _split(frame: dict[str, Any], splits: dict[str, Split]) -> Split | None:
    return splits.get(_key(frame.get("file_path")), Split.TRAIN) if splits else None


def _key(path: Any) -> str:
    return str(PurePosixPath(str(path).replace("\\", "/")))


class _Applied:
    """The transform and scale that the file's writer applied to the poses, which its methods undo."""

    def __init__(self, content: dict[str, Any]) -> None:
        source = f"{_FILE}, applied_transform"
        self._scale = number(content, "applied_scale", _FILE) if "applied_scale" in content else 1.0
        if self._scale <= 0:
            raise SceneError(f"{_FILE}: applied_scale: expected a number above 0, got {self._scale:g}")
        pose = np.eye(4)
        if "applied_transform" in content:
            given = np.array(content["applied_transform"], dtype=object)
            rows = 4 if given.ndim and len(given) == 4 else 3
            pose[:rows] = matrix_from(content["applied_transform"], rows, 4, "applied_transform", _FILE)
        self._rotation, self._offset, scale = split_pose(pose, source)
        self._scale *= scale
        self._offset = self._offset / scale

    def photo(self, photo: Photo) -> Photo:
        pose = photo.cam_from_world.copy()
        pose[:3, 3] /= self._scale
        return replace(photo, cam_from_world=pose @ rigid(self._rotation, self._offset))

    def points(self, points: PointCloud | None) -> PointCloud | None:
        if points is None:
            return None
        return PointCloud((points.positions / self._scale - self._offset) @ self._rotation, points.colors)


FORMAT = Format("nerfstudio", f"{_FILE} (nerfstudio, instant-ngp)", recognises, read, rank=40)
