"""RealityCapture / RealityScan: the CSV of its "Internal/External camera parameters" export, and the photographs."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import ImageIndex, find_mask
from mgsr.data.images import image_size
from mgsr.data.lens import Lens
from mgsr.data.poses import from_opengl, intrinsics
from mgsr.data.registration import check_share
from mgsr.errors import SceneError, in_short

_POSE = ("x", "y", "alt", "heading", "pitch", "roll")
_NEEDED = ("#name", *_POSE, "f")
_OPTIONAL = ("px", "py", "k1", "k2", "t1", "t2", "k3", "k4")
_FILM = 36.0  # millimetres: lengths on the sensor are those of 35 mm film, whose larger side this is


def recognises(root: Path) -> str | None:
    """The first .csv of the folder whose header has the needed columns."""
    paths = (path for path in sorted(root.glob("*.csv")) if path.is_file())
    return next((path.name for path in paths if _header(path) is not None), None)


def read(root: Path) -> Capture:
    """Every row's photograph, found by name anywhere in the folder, in the frame of the export (z up).

    Raises SceneError where more than half of the photographs are missing.
    """
    name = recognises(root)
    assert name is not None, "read() is for folders that were recognised"
    rows = _rows(root / name)
    index = ImageIndex(root)
    found = [(i, row, index.find(row["#name"], f"{name}, row {i}")) for i, row in enumerate(rows, start=1)]
    photos = [_photo(root, row, image, f"{name}, row {i} ({image.name})") for i, row, image in found if image]
    cure = f"put the missing ones into {root.name}"
    return Capture(photos, notes=check_share(len(photos), len(rows), 0.5, f"named by {name} are there", cure))


def _header(path: Path) -> int | None:
    """The number of the line with the columns' names: the first, or after a line that counts the cameras."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            head = [file.readline(10_000) for _ in range(2)]
    except (OSError, UnicodeDecodeError):
        return None
    return next((i for i, line in enumerate(head) if set(_NEEDED) <= set(line.strip().lower().split(","))), None)


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for _ in range(_header(path) or 0):
                file.readline()
            reader = csv.reader(file)
            names = [name.strip().lower() for name in next(reader)]
            rows = [row for row in reader if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"{path.name}: can't be read as CSV: {in_short(error)}; export it again") from error
    for i, row in enumerate(rows, start=1):
        if len(row) != len(names):
            raise SceneError(f"{path.name}, row {i}: expected {len(names)} values, got {len(row)}; export it again")
    return [dict(zip(names, row, strict=True)) for row in rows]


def _photo(root: Path, row: dict[str, str], image: Path, source: str) -> Photo:
    size = image_size(image, source)
    x, y, alt, heading, pitch, roll = (_value(row, name, source) for name in _POSE)
    pose = np.eye(4)
    # Zero angles look straight down with north at the top; heading turns clockwise.
    pose[:3, :3] = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True).as_matrix()
    pose[:3, 3] = x, y, alt
    unit = max(size) / _FILM
    px, py, k1, k2, t1, t2, k3, k4 = (_value(row, name, source) if name in row else 0.0 for name in _OPTIONAL)
    focal = _value(row, "f", source) * unit
    lens = Lens(k1, k2, t1, t2, (k3, k4))
    return Photo(
        image=image,
        K=intrinsics(focal, focal, size[0] / 2 + px * unit, size[1] / 2 + py * unit),
        size=size,
        cam_from_world=from_opengl(pose, source),
        source=source,
        mask=find_mask(root, image),
        lens=None if lens.flat else lens,
    )


def _value(row: dict[str, str], name: str, source: str) -> float:
    try:
        value = float(row[name])
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise SceneError(f"{source}: {name}: expected a number, got {row[name][:80]!r}")
    return value


FORMAT = Format("realitycapture", f"a .csv with {','.join(_NEEDED)} (RealityCapture)", recognises, read, rank=90)
