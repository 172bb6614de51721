"""Matrices and intrinsics in text files, as research captures have them: numbers, one row per line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mgsr.data.files import IMAGE_SUFFIXES, text_number
from mgsr.data.odd_files import require_content
from mgsr.data.poses import intrinsics, pose_from
from mgsr.errors import SceneError, in_short

# The file of one camera has some hundred bytes; one of a whole capture a few megabytes.
LARGEST_CAMERA = 1 << 16
LARGEST_CAPTURE = 1 << 26

# Maps and masks that lie beside photographs: 0-depth.png, 0_mask.png, 0.mask.png.
_MAP = re.compile(r"[-_.](depth|mask|masked|normal|albedo|alpha|seg|conf|confidence)$", re.IGNORECASE)


def read_rows(path: Path, largest: int = LARGEST_CAMERA) -> list[list[float]]:
    """Read the rows of numbers of a text file, without empty lines.

    Raises SceneError that names the line that holds something else.
    """
    lines = enumerate(read_lines(path, largest), start=1)
    rows = [row_from(line, f"{path.name}, line {number}") for number, line in lines]
    return [row for row in rows if row]


def row_from(line: str, source: str) -> list[float]:
    """Return the numbers of a line, separated by blanks or commas, without a comment (#).

    What C prints for NaN and infinity becomes NaN. Raises SceneError with `source`.
    """
    try:
        return [text_number(word) for word in line.split("#")[0].replace(",", " ").split()]
    except ValueError as error:
        raise SceneError(f"{source}: expected numbers: {in_short(error)}; fix the file") from error


def read_lines(path: Path, largest: int = LARGEST_CAMERA) -> list[str]:
    """Read the lines of a text file.

    Raises SceneError for files that are missing, larger than `largest` bytes, or no text.
    """
    require_content(path)
    try:
        if path.stat().st_size > largest:
            raise SceneError(f"{path.name}: expected a text file of at most {largest} bytes, got {path.stat().st_size}")
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise SceneError(f"{path.name}: this file is not text: {in_short(error)}; copy it again") from error


def read_pose(path: Path) -> np.ndarray:
    """Read a pose [4,4] of 12 or 16 numbers. Raises SceneError."""
    numbers = [number for row in read_rows(path) for number in row]
    if len(numbers) not in (12, 16):
        raise SceneError(f"{path.name}: expected a pose of 3x4 or 4x4 numbers, got {len(numbers)}; fix the file")
    return pose_from(numbers, "pose", path.name)


def read_intrinsics(path: Path) -> tuple[np.ndarray, tuple[int, int] | None]:
    """Read K [3,3] as the file has it, and the size (width, height) of its image if the file gives it.

    The file holds a 3x3, 3x4 or 4x4 matrix, or fx fy cx cy. In DeepVoxels, SRN and NSVF it holds f cx cy in the first
    line, and height and width in a separate line. Raises SceneError for anything else.
    """
    rows = read_rows(path)
    numbers = [number for row in rows for number in row]
    widths = [len(row) for row in rows]
    if len(numbers) in (9, 12, 16) and len(set(widths)) == 1:
        return np.array(numbers).reshape(-1, 3 if len(numbers) == 9 else 4)[:3, :3], None
    if len(rows) > 1 and widths[0] in (3, 4):
        return _one_focal(rows[0]), _size(rows[1:])
    if len(numbers) == 4 and numbers[3]:
        return intrinsics(*numbers), None
    if len(numbers) in (3, 4):
        return _one_focal(numbers), None
    # Elastic Reconstruction's camera files have two limits of depth after these.
    if len(numbers) == 6 and set(widths) == {1}:
        return intrinsics(*numbers[:4]), None
    raise SceneError(
        f"{path.name}: expected intrinsics as a 3x3 or 4x4 matrix or as fx fy cx cy, got rows of {widths[:8]} "
        "numbers; fix the file"
    )


def _one_focal(row: list[float]) -> np.ndarray:
    """Return the intrinsics [3,3] of a row: focal length and principal point, in pixels."""
    return intrinsics(row[0], row[0], row[1], row[2])


def _size(rows: list[list[float]]) -> tuple[int, int] | None:
    """Return the size (width, height) from the last row of two whole numbers, height first; None without one."""
    sizes = [row for row in rows if len(row) == 2 and all(1 < side < 1e6 for side in row)]
    return (int(sizes[-1][1]), int(sizes[-1][0])) if sizes else None


@np.errstate(over="ignore")  # what overflows is no factor
def calibrated_size(K: np.ndarray, size: tuple[int, int]) -> tuple[int, int]:
    """Return the size of the image that K [3,3] is for, where its file does not say it.

    It is the photograph's size, or a power of two times that size if the principal point lies in the middle of such an
    image. Some research captures have reduced photographs with the intrinsics of the full ones, or the reverse.
    """
    middle = 2 * K[:2, 2] / np.array(size)
    if not np.isfinite(middle).all() or (middle <= 0).any():
        return size
    factor = 2.0 ** np.round(np.log2(middle).mean())
    if factor == 1 or not 1 / 16 <= factor <= 16 or np.abs(middle / factor - 1).max() > 0.15:
        return size
    width, height = (max(1, round(side * factor)) for side in size)
    return width, height


def photographs_in(folder: Path) -> list[Path]:
    """Return the photographs directly in a folder, by name, without maps and masks; empty if there is none."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if _is_photograph(path))


def _is_photograph(path: Path) -> bool:
    is_image = path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    return is_image and not _MAP.search(path.stem) and path.is_file()


def folders_in(folder: Path) -> list[Path]:
    """Return the folders in a folder, by name, without hidden ones; empty if there is none."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith((".", "__")))


def texts_in(folder: Path, pattern: str = "*.txt") -> list[Path]:
    """Return the text files in a folder, by name, without hidden ones; empty if there is none."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.glob(pattern) if path.is_file() and not path.name.startswith("."))


def head_of(path: Path, size: int = 4096) -> bytes:
    """Return the first bytes of a file; none if it can't be read."""
    try:
        with path.open("rb") as file:
            return file.read(size)
    except OSError:
        return b""
