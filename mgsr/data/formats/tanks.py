"""Pose logs of Tanks and Temples, Open3D and Elastic Reconstruction.

For each photograph, a log has a line of three numbers and a pose. Photographs are in the order of their names.

Poses map the camera to the world, with OpenCV's axes. The line before a pose begins with the photograph's number, which
is 0 for 000001.jpg. The second number is -1 if the photograph has no pose. Source: the benchmark's toolbox
(isl-org/TanksAndTemples, convert_to_logfile.py) and its issue 36.

The log holds no intrinsics, so they must lie beside it. The benchmark's download page suggests a focal length of 0.7
times the width. Its own models have about 0.6 (MVSNet's cameras of Auditorium: 1163 pixels of 1920), so the suggestion
is not used.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import number, read_json
from mgsr.data.images import image_size
from mgsr.data.number_files import (
    LARGEST_CAPTURE,
    calibrated_size,
    folders_in,
    head_of,
    photographs_in,
    read_intrinsics,
    read_rows,
    texts_in,
)
from mgsr.data.number_lists import numbers
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_world_from_cam, intrinsics, pose_from
from mgsr.errors import SceneError

_FIRST_LINES = re.compile(rb"\s*(-?\d+[ \t]+){2}-?\d+[ \t]*\r?\n(([^\s]+[ \t]+){3}[^\s]+[ \t]*\r?\n){4}")
_TEXTS = re.compile(r"(.*[_.-])?(intrinsics?|k|camera)([_.-].*)?\.(txt|param)", re.IGNORECASE)
_NUMBERED = re.compile(r"\d{6}")
_JSONS = re.compile(r"(.*[_.-])?(intrinsics?|camera)([_.-].*)?\.json", re.IGNORECASE)


def recognises(root: Path) -> str | None:
    """Return the first .log file that begins with three whole numbers and four rows of four numbers."""
    logs = sorted(root.glob("[!.]*.log"), key=lambda path: ("_COLMAP_SfM" not in path.name, path.name))
    return next((path.name for path in logs if path.is_file() and _FIRST_LINES.match(head_of(path) + b"\n")), None)


@dataclass(frozen=True)
class _LogEntry:
    """An entry of the log. number: the photograph's number, which gives their order. pose: its 16 numbers, by rows."""

    number: int
    pose: list[float]
    has_pose: bool


@dataclass(frozen=True)
class _Calibration:
    """The calibration of all photographs: K [3,3] in pixels, and its image size (width, height), None if unknown."""

    K: np.ndarray
    size: tuple[int, int] | None


def read(folder: SceneFolder) -> Capture:
    """Read the pose of every photograph that has one. Raises SceneError if there are no intrinsics."""
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    everything = _entries(folder.root / name)
    entries = [entry for entry in everything if entry.has_pose]
    if not entries:
        raise SceneError(f"{name}: the log has no pose of a photograph; write it again")
    photographs = _photographs(folder, name, [entry.number for entry in everything])
    calibration = _calibration(folder.root, name)
    found = folder.find_photos(name, [photographs[entry.number] for entry in entries])
    capture = Capture.of(found, lambda i, image: _photo(image, entries[i], calibration, name))
    left = len(everything) - len(entries)
    notes = (f"{name} has no pose of {left} of {len(everything)} photographs",) if left else ()
    return replace(capture, notes=(*capture.notes, *notes))


def _entries(path: Path) -> list[_LogEntry]:
    """Read the entries of a log, each of five lines. Raises SceneError for entries of another form."""
    rows = read_rows(path, LARGEST_CAPTURE)
    blocks = [rows[i : i + 5] for i in range(0, len(rows), 5)]
    for i, block in enumerate(blocks):
        if [len(row) for row in block] != [3, 4, 4, 4, 4]:
            raise SceneError(
                f"{path.name}: entry {i}: expected three numbers and four rows of four numbers; copy the file again"
            )
    firsts = [block[0][0] for block in blocks]
    # Open3D's logs repeat the first number, or do not start from 0. Then the order of the entries counts.
    if sorted(firsts) != [*range(len(blocks))] and not _are_a_choice(firsts):
        firsts = [*range(len(blocks))]
    return [
        _LogEntry(int(number), [*itertools.chain(*block[1:])], has_pose=block[0][1] != -1)
        for number, block in zip(firsts, blocks, strict=True)
    ]


def _are_a_choice(firsts: list[float]) -> bool:
    """Return whether first numbers can number photographs: they are whole and distinct, and one is 0."""
    return 0 in firsts and len(set(firsts)) == len(firsts) and all(0 <= n < 1e6 and n == int(n) for n in firsts)


def _photographs(folder: SceneFolder, name: str, order: list[int]) -> dict[int, str]:
    """Return the photograph of each entry by its number, in the order of the photographs' names.

    The first folder with as many photographs as the log has entries is used. Without one, the benchmark's names are
    used if the first folder's photographs have such names; some may then be missing. Raises SceneError otherwise.
    """
    root = folder.root
    scene = name.removesuffix(".log").removesuffix("_COLMAP_SfM")
    known = [root / place for place in ("images", scene, "color", "image", "rgb", ".")]
    places = [*known, *(place for place in folders_in(root) if place not in known)]
    found = [photographs for place in places if (photographs := photographs_in(place))]
    best = next((photographs for photographs in found if len(photographs) == len(order)), None)
    if best is not None:
        return {n: str(path.relative_to(root)) for n, path in zip(sorted(order), best, strict=True)}
    if found and all(_NUMBERED.fullmatch(path.stem) for path in found[0]):
        return {n: str(found[0][0].with_name(f"{n + 1:06d}").relative_to(root)) for n in order}
    there = (
        f"{folder.shown(found[0][0].parent)} has {len(found[0])} photographs" if found else "there are no photographs"
    )
    raise SceneError(
        f"{name}: it has {len(order)} poses, but {there}; poses follow the order of the photographs' names, so copy "
        "exactly these to images/"
    )


def _calibration(root: Path, name: str) -> _Calibration:
    """Read the intrinsics beside a log. Raises SceneError if there are none."""
    texts = [path for path in texts_in(root, "*") if _TEXTS.fullmatch(path.name)]
    if texts:
        return _Calibration(*read_intrinsics(texts[0]))
    for path in texts_in(root, "*.json"):
        if _JSONS.fullmatch(path.name):
            return _from_json(read_json(path), path.name)
    raise SceneError(
        f"{name}: it has poses but no intrinsics; write fx fy cx cy in pixels to intrinsics.txt beside it, or add a "
        "COLMAP model in sparse/"
    )


def _from_json(content: Any, source: str) -> _Calibration:
    """Return the intrinsics from Open3D's PinholeCameraIntrinsic, or from fx fy cx cy.

    Open3D stores its matrix by columns. Raises SceneError for anything else.
    """
    values = content.get("intrinsic", content) if isinstance(content, dict) else None
    if not isinstance(values, dict):
        raise SceneError(f"{source}: expected intrinsics in Open3D's form; fix the file")
    if "intrinsic_matrix" in values:
        K = numbers(values["intrinsic_matrix"], 9, "intrinsic_matrix", source).reshape(3, 3)
        K = K if K[:2, 2].any() else K.T
    else:
        K = intrinsics(*(number(values, key, source) for key in ("fx", "fy", "cx", "cy")))
    if "width" not in values or "height" not in values:
        return _Calibration(K, None)
    return _Calibration(K, (round(number(values, "width", source)), round(number(values, "height", source))))


def _photo(image: Path, entry: _LogEntry, calibration: _Calibration, name: str) -> Photo:
    source = f"{name}, photograph {entry.number}"
    size = calibration.size or calibrated_size(calibration.K, image_size(image, source))
    pose = from_world_from_cam(pose_from(entry.pose, "pose", source), source)
    return Photo(image, calibration.K, size, pose, source)


FORMAT = Format("tanks", "a .log of poses, intrinsics.txt and images/ (Tanks and Temples)", recognises, read, rank=170)
