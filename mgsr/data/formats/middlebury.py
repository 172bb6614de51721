"""Middlebury multi-view: a `*_par.txt` file with one line per photograph, and the photographs beside it.

Source: the README of the Middlebury multi-view stereo data (Seitz et al. 2006).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import text_number
from mgsr.data.images import image_size
from mgsr.data.odd_files import require_content
from mgsr.data.photo_files import SceneFolder
from mgsr.errors import SceneError, in_short

_PATTERN = "*_par.txt"


def recognises(root: Path) -> str | None:
    """Return the folder's first *_par.txt file, or None."""
    return next((path.name for path in sorted(root.glob("[!.]" + _PATTERN)) if path.is_file()), None)


def read(folder: SceneFolder) -> Capture:
    """Read one photograph per line: its name, then K, R and t row by row. The first line counts the others.

    Published subsets of these data come with the whole file, so any share of the photographs is enough.
    """
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    lines = _lines(folder.root / name)
    found = folder.find_photos(name, [line[0] for line in lines])
    capture = Capture.of(found, lambda i, path: _photo(path, lines[i], f"{name}, line {i + 2}"))
    return replace(capture, least_kept=0.0)


def _lines(path: Path) -> list[list[str]]:
    require_content(path)
    try:
        lines = [line.split() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path.name}: this file is not text: {in_short(error)}; copy it again") from error
    if not lines or lines[0] != [str(len(lines) - 1)]:
        first = " ".join(lines[0])[:40] if lines else "nothing"
        raise SceneError(
            f"{path.name}: expected the number of further lines ({max(0, len(lines) - 1)}) in the first line, got "
            f"{first!r}"
        )
    return lines[1:]


def _photo(image: Path, line: Sequence[str], source: str) -> Photo:
    try:
        numbers = np.array([text_number(text) for text in line[1:]])
    except ValueError as error:
        raise SceneError(f"{source}: {in_short(error)}; expected an image's name and 21 numbers") from error
    if len(numbers) != 21:
        raise SceneError(f"{source}: expected an image's name and 21 numbers (K, R, t), got {len(numbers)} numbers")
    K, pose = numbers[:9].reshape(3, 3).copy(), np.eye(4)
    # The data have pixel centres at 0; MGSR has them at +0.5.
    K[:2, 2] += 0.5 * K[2, 2]
    pose[:3, :3], pose[:3, 3] = numbers[9:18].reshape(3, 3), numbers[18:]
    return Photo(image, K, image_size(image, source), pose, source)


FORMAT = Format("middlebury", f"{_PATTERN} (Middlebury multi-view)", recognises, read, rank=50)
