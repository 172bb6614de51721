"""Middlebury multi-view: a `*_par.txt` with a line for each photograph, and the photographs beside it.

Source: the README of the Middlebury multi-view stereo data (Seitz et al. 2006).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import find_image
from mgsr.data.images import image_size
from mgsr.data.registration import check_share
from mgsr.errors import SceneError, in_short

_PATTERN = "*_par.txt"


def recognises(root: Path) -> str | None:
    """The first *_par.txt of the folder, if there is one."""
    return next((path.name for path in sorted(root.glob("[!.]" + _PATTERN)) if path.is_file()), None)


def read(root: Path) -> Capture:
    """A photograph for each line after the first, which counts them: name, K, R and t, row by row. Lines whose
    photograph isn't there are left out."""
    name = recognises(root)
    assert name is not None, "read() is for folders that were recognised"
    try:
        lines = [line.split() for line in (root / name).read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{name}: can't be read as text: {in_short(error)}") from error
    if not lines or lines[0] != [str(len(lines) - 1)]:
        first = " ".join(lines[0])[:40] if lines else "nothing"
        raise SceneError(
            f"{name}: the first line must be the count of the others ({max(0, len(lines) - 1)}), got {first!r}"
        )
    photos = [_photo(root, line, f"{name}, line {i}") for i, line in enumerate(lines[1:], start=2)]
    there = [photo for photo in photos if photo is not None]
    # People hand on parts of these data with the whole file, so that any share will do.
    return Capture(there, notes=check_share(len(there), len(photos), 0.0, f"of {name} are there", ""))


def _photo(root: Path, line: list[str], source: str) -> Photo | None:
    try:
        numbers = np.array(line[1:], dtype=np.float64)
    except ValueError as error:
        raise SceneError(f"{source}: {in_short(error)}; expected an image's name and 21 numbers") from error
    if len(numbers) != 21:
        raise SceneError(f"{source}: expected an image's name and 21 numbers (K, R, t), got {len(numbers)} numbers")
    image = find_image(root, line[0], source)
    if not image.is_file():
        return None
    K, pose = numbers[:9].reshape(3, 3).copy(), np.eye(4)
    # The data count pixels from the middle of the first one.
    K[:2, 2] += 0.5 * K[2, 2]
    pose[:3, :3], pose[:3, 3] = numbers[9:18].reshape(3, 3), numbers[18:]
    return Photo(image, K, image_size(image, source), pose, source)


FORMAT = Format("middlebury", f"{_PATTERN} (Middlebury multi-view)", recognises, read, rank=50)
