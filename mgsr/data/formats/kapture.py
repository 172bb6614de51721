"""Kapture: sensors/ with cameras, poses and the photographs.

Source: kapture's "data format v1.1" (kapture_format.adoc). A pose is a quaternion and a translation. It maps the world
to a device, or a rig to one of its sensors. Camera models are COLMAP's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.formats.colmap import checked_camera, to_pinhole
from mgsr.data.lens import AnyLens
from mgsr.data.number_lists import grey, numbers, point_cloud, rotation_of
from mgsr.data.odd_files import require_content
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import rigid
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError, in_short

_SENSORS, _RECORDS = "sensors/sensors.txt", "sensors/records_camera.txt"
_TRAJECTORIES, _RIGS = "sensors/trajectories.txt", "sensors/rigs.txt"
_POINTS = "reconstruction/points3d.txt"
_DATA = "sensors/records_data"
_DEEPEST_RIG = 10


def recognises(root: Path) -> str | None:
    """Return the file of the cameras' records if the file of sensors exists too."""
    return _RECORDS if all((root / name).is_file() for name in (_SENSORS, _RECORDS)) else None


def read(folder: SceneFolder) -> Capture:
    """Read the points, and every camera record that has a pose, either its own or its rig's.

    Raises SceneError if the file of poses is missing.
    """
    if not (folder.root / _TRAJECTORIES).is_file():
        raise SceneError(f"{folder.root.name} lacks {_TRAJECTORIES}, the file of poses; add it")
    records = list(_rows(folder.root, _RECORDS, 3))
    dataset = _dataset(folder.root)
    found = folder.find_photos(_RECORDS, [row[2] for row in records], (_DATA, "."))
    capture = Capture.of(found, lambda i, path: _photo(path, records[i], dataset))
    return replace(capture, points=_points(folder.root), least_kept=0.25)


@dataclass(frozen=True)
class _Dataset:
    """The sensors, poses and rigs of a dataset.

    sensors: each sensor's fields, by its id. poses: each pose's fields, by time and device. rigs: for each device, its
    rigs, each with the fields of the device's pose in it.
    """

    sensors: dict[str, list[str]]
    poses: dict[tuple[str, str], list[str]]
    rigs: dict[str, list[tuple[str, list[str]]]]


def _dataset(root: Path) -> _Dataset:
    rigs: dict[str, list[tuple[str, list[str]]]] = {}
    if (root / _RIGS).is_file():
        for rig, device, *pose in _rows(root, _RIGS, 9):
            rigs.setdefault(device, []).append((rig, pose[:7]))
    return _Dataset(
        sensors={row[0]: row[1:] for row in _rows(root, _SENSORS, 3)},
        poses={(_time(row[0]), row[1]): row[2:9] for row in _rows(root, _TRAJECTORIES, 9)},
        rigs=rigs,
    )


def _time(text: str) -> str:
    """Return a time without leading zeros, since the files of a dataset may pad times differently."""
    return text.lstrip("0") or "0"


def _rows(root: Path, name: str, least: int) -> Iterator[list[str]]:
    """Yield the rows of a file of comma-separated values. Raises SceneError for rows with fewer than `least` values."""
    path = root / name
    require_content(path)
    try:
        with path.open(encoding="utf-8-sig") as file:
            for number, line in enumerate(file, start=1):
                if line.strip() and not line.startswith("#"):
                    row = [field.strip() for field in line.split(",")]
                    if len(row) < least:
                        raise SceneError(
                            f"{name}, line {number}: expected at least {least} values separated by commas, got "
                            f"{line.strip()[:80]!r}; fix the file"
                        )
                    yield row
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{name}: this file is not text: {in_short(error)}; export it again") from error


def _photo(image: Path, record: list[str], dataset: _Dataset) -> Photo:
    time, device, name = record[:3]
    source = f"{_RECORDS}, {name[:200]}"
    K, lens, size = _camera(dataset.sensors.get(device), device, source)
    pose = _pose(_time(time), device, dataset, source, _DEEPEST_RIG)
    if pose is None:
        raise SceneError(f"{source}: {_TRAJECTORIES} has no pose of {device[:80]} or its rig at time {time[:80]}")
    return Photo(image, K, size, pose, source, lens=lens)


def _camera(sensor: list[str] | None, device: str, source: str) -> tuple[np.ndarray, AnyLens | None, tuple[int, int]]:
    """Return the intrinsics [3,3] in pixels, the lens, and the image size (width, height) of a device.

    Raises SceneError for a missing or unsupported camera.
    """
    if sensor is None or len(sensor) < 5 or sensor[1] != "camera" or sensor[2] == "UNKNOWN_CAMERA":
        raise SceneError(
            f"{source}: {_SENSORS} has no camera {device[:80]} with a model and its parameters; calibrate it, for "
            "example with COLMAP, and export the dataset again"
        )
    model, values = sensor[2][:40], numbers(sensor[3:], len(sensor[3:]), f"parameters of {device[:80]}", source)
    try:
        camera = checked_camera(model, int(values[0]), int(values[1]), tuple(values[2:].tolist()))
    except ValueError as error:
        raise SceneError(f"{source}: {_SENSORS}: {in_short(error)}; fix the file") from error
    K, lens = to_pinhole(camera, source)
    return K, lens, (camera.width, camera.height)


def _pose(time: str, device: str, dataset: _Dataset, source: str, depth: int) -> np.ndarray | None:
    """Return cam_from_world [4,4] of a device, or None if it has no pose.

    The device has a pose of its own, or its place in a rig is composed with the rig's pose. `depth` limits how deeply
    rigs may nest.
    """
    own = dataset.poses.get((time, device))
    if own is not None:
        return _rigid(own, source)
    for rig, place in dataset.rigs.get(device, []) if depth else []:
        rig_from_world = _pose(time, rig, dataset, source, depth - 1)
        if rig_from_world is not None:
            device_from_world: np.ndarray = _rigid(place, source) @ rig_from_world
            return device_from_world
    return None


def _rigid(fields: list[str], source: str) -> np.ndarray:
    """Return the pose [4,4] from seven fields of a file: a quaternion wxyz and a translation."""
    values = numbers(fields, 7, "pose", source)
    return rigid(rotation_of(values[:4], source), values[4:])


def _points(root: Path) -> PointCloud | None:
    """Return the points, grey if they have no colour; None without a file of points."""
    if not (root / _POINTS).is_file():
        return None
    rows = list(_rows(root, _POINTS, 3))
    return point_cloud([row[:3] for row in rows], [row[3:6] or grey(1)[0] for row in rows])


FORMAT = Format("kapture", f"{_RECORDS} and trajectories.txt (kapture)", recognises, read, rank=160)
