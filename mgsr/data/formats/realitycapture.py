"""RealityCapture / RealityScan: the CSV of its "Internal/External camera parameters" export, and the photographs.

Source: the export templates that RealityScan 2.2 ships (calibration.xml), which also write the same cameras for OpenCV,
and "RealityCapture XMP Camera Math" in its knowledge base.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import text_number
from mgsr.data.images import image_size
from mgsr.data.lens import Lens
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_opengl, intrinsics
from mgsr.errors import SceneError, in_short

_POSE = ("x", "y", "alt", "heading", "pitch", "roll")
_NEEDED = ("#name", *_POSE, "f")
_OPTIONAL = ("px", "py", "k1", "k2", "t1", "t2", "k3", "k4")
_SINCE_2 = {"yaw": "heading", "f_35mm": "f", "px_norm": "px", "py_norm": "py"}  # RealityScan 2's names for columns
_FILM = 36.0  # millimetres: the larger side of 35 mm film, to which focal lengths refer


def recognises(root: Path) -> str | None:
    """Return the folder's first .csv file with the required columns, else the first with a RealityCapture header."""
    paths = (path for path in sorted(root.glob("[!.]*.[cC][sS][vV]")) if path.is_file())
    found = [(path.name, header) for path in paths if (header := _header(path))]
    return min(found, key=lambda item: not item[1].fits)[0] if found else None


def read(folder: SceneFolder) -> Capture:
    """Read the photograph of every row in the export's frame, z up. Photographs may lie anywhere in the folder."""
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    rows = _rows(folder.root / name)
    found = folder.find_photos(name, [row["#name"] for row in rows], labels=True)
    return Capture.of(found, lambda i, path: _photo(rows[i], path, f"{name}, row {i + 1} ({path.name})"))


@dataclass(frozen=True)
class _Header:
    """The header of a table. line: the number of lines before it. columns: the names in lower case."""

    line: int
    columns: tuple[str, ...]

    @property
    def fits(self) -> bool:
        """Return whether all required columns exist."""
        return set(_NEEDED) <= set(self.columns)


def _header(path: Path) -> _Header | None:
    """Return the header from the first line, or from the second after a count of the cameras.

    Returns None if neither line is a header of RealityCapture.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            head = [file.readline(10_000).strip().lower() for _ in range(2)]
    except (OSError, UnicodeDecodeError):
        return None
    found = next((i for i, line in enumerate(head) if line.startswith("#name")), None)
    if found is None:
        return None
    names = (name.strip() for name in head[found].split(","))
    return _Header(found, tuple(_SINCE_2.get(name, name) for name in names))


def _rows(path: Path) -> list[dict[str, str]]:
    header = _header(path)
    if header is None or not header.fits:
        columns = ",".join(header.columns)[:200] if header else "unreadable"
        raise SceneError(
            f"{path.name}: expected the columns {','.join(_NEEDED)}, separated by commas, got {columns}; export "
            '"Internal/External camera parameters" with the default settings'
        )
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in list(csv.reader(file))[header.line + 1 :] if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"{path.name}: this file is not CSV: {in_short(error)}; export it again") from error
    if not rows:
        raise SceneError(f"{path.name}: the table has no rows; align the photographs and export it again")
    for i, row in enumerate(rows, start=1):
        if len(row) != len(header.columns):
            raise SceneError(
                f"{path.name}, row {i}: expected {len(header.columns)} values, got {len(row)}; export it again, with "
                "commas between values and decimal points in numbers"
            )
    return [dict(zip(header.columns, row, strict=True)) for row in rows]


def _photo(row: dict[str, str], image: Path, source: str) -> Photo:
    size = image_size(image, source)
    x, y, alt, heading, pitch, roll = (_value(row, name, source) for name in _POSE)
    pose = np.eye(4)
    # With zero angles the camera looks straight down, with north at the top. The heading turns clockwise.
    pose[:3, :3] = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True).as_matrix()
    pose[:3, 3] = x, y, alt
    # The principal point is relative to the middle of the image, in units of its larger side.
    side = max(size)
    px, py, k1, k2, t1, t2, k3, k4 = (_value(row, name, source) if name in row else 0.0 for name in _OPTIONAL)
    focal = _value(row, "f", source) / _FILM * side
    lens = Lens(k1, k2, p1=t2, p2=t1, higher=(k3, k4))
    return Photo(
        image=image,
        K=intrinsics(focal, focal, size[0] / 2 + px * side, size[1] / 2 + py * side),
        size=size,
        cam_from_world=from_opengl(pose, source),
        source=source,
        lens=None if lens.flat else lens,
    )


def _value(row: dict[str, str], name: str, source: str) -> float:
    try:
        value = text_number(row[name].strip())
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise SceneError(f"{source}: {name}: expected a number, got {row[name][:80]!r}")
    return value


FORMAT = Format("realitycapture", f"a .csv with {','.join(_NEEDED)} (RealityCapture)", recognises, read, rank=90)
