"""nerfstudio and instant-ngp: one transforms.json with camera-to-world poses, OpenGL axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import find_image, inside, number
from mgsr.data.pointclouds import read_points
from mgsr.data.poses import check_pose, matrix_from
from mgsr.data.registration import check_share
from mgsr.data.scene import PointCloud
from mgsr.data.transforms import merged_frames, read_content, read_frame, refuse_doubles
from mgsr.errors import SceneError

_FILE = "transforms.json"


def recognises(root: Path) -> str | None:
    """transforms.json, if the folder has it."""
    return _FILE if (root / _FILE).is_file() else None


def read(root: Path) -> Capture:
    """Every frame whose photograph is there, in the frame that the poses had before `applied_transform` and
    `applied_scale`; the file's own split where it names one; the points of `ply_file_path`.

    Raises SceneError where more than half of the photographs are missing, or one is there twice.
    """
    content = read_content(root / _FILE)
    splits = _splits(content)
    frames = merged_frames(content, _FILE)
    found = [(source, frame, find_image(root, frame.get("file_path"), source)) for source, frame in frames]
    missing = [str(frame["file_path"]) for _, frame, image in found if not image.is_file()]
    cure = f"put the missing ones where {_FILE} has them, its paths are relative to its own folder"
    kept = len(frames) - len(missing)
    notes = check_share(kept, len(frames), 0.5, f"named by {_FILE} are there", cure, missing)
    there = [(source, frame) for source, frame, image in found if image.is_file()]
    photos = [read_frame(root, source, frame, _split(frame, splits)) for source, frame in there]
    refuse_doubles(photos)
    undo = _Applied(content)
    points = None
    if content.get("ply_file_path"):
        path = inside(root, content["ply_file_path"], f"{_FILE}, ply_file_path")
        points = read_points(path) if path.is_file() else None
    return Capture([undo.photo(photo) for photo in photos], undo.points(points), notes)


def _splits(content: dict[str, Any]) -> dict[str, Split]:
    """What the file's lists of names say; validation frames are tests where there are no others."""
    lists = {part: content.get(f"{part}_filenames") for part in ("train", "val", "test")}
    if not all(names is None or isinstance(names, list) for names in lists.values()):
        raise SceneError(f"{_FILE}: expected lists of paths as train_filenames, val_filenames, test_filenames")
    part = "test" if lists["test"] else "val"
    train, tests = ([_key(name) for name in lists[name] or []] for name in ("train", part))
    if both := set(train) & set(tests):
        raise SceneError(
            f"{_FILE}: {min(both)[:200]} is in train_filenames and in {part}_filenames; remove it from one of them"
        )
    return dict.fromkeys(train, Split.TRAIN) | dict.fromkeys(tests, Split.TEST) if tests else {}


def _split(frame: dict[str, Any], splits: dict[str, Split]) -> Split | None:
    return splits.get(_key(frame.get("file_path")), Split.TRAIN) if splits else None


def _key(path: Any) -> str:
    return str(PurePosixPath(str(path).replace("\\", "/")))


class _Applied:
    """The way back from a transform and scale that were applied to the poses when the file was written."""

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
        self._file_from_user = check_pose(pose, source)

    def photo(self, photo: Photo) -> Photo:
        pose = photo.cam_from_world.copy()
        pose[:3, 3] /= self._scale
        return replace(photo, cam_from_world=pose @ self._file_from_user)

    def points(self, points: PointCloud | None) -> PointCloud | None:
        if points is None:
            return None
        rotation, offset = self._file_from_user[:3, :3], self._file_from_user[:3, 3]
        return PointCloud((points.positions / self._scale - offset) @ rotation, points.colors)


FORMAT = Format("nerfstudio", f"{_FILE} (nerfstudio, instant-ngp)", recognises, read, rank=40)
