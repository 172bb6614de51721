"""The unit of a PLY that MGSR wrote, kept in its header, so that later steps find their way back to the capture's."""

from __future__ import annotations

import math
from pathlib import Path

_WORDS = ("mgsr", "unit")
_LONGEST_HEADER = 1 << 16


def unit_comments(unit: float) -> list[str]:
    """The header's comments for a file whose lengths are the capture's times `unit`; none for 1."""
    return [] if unit == 1 else [f"{' '.join(_WORDS)} {unit!r}"]


def read_unit(path: Path) -> float:
    """What the lengths of a PLY are multiplied with against the capture's; 1 where its header does not say."""
    with path.open("rb") as file:
        header = file.read(_LONGEST_HEADER).partition(b"end_header")[0]
    for line in header.decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["comment"] and tuple(words[1:3]) == _WORDS and len(words) == 4:
            return _positive(words[3])
    return 1.0


def _positive(text: str) -> float:
    """1 for what is no number above 0: other programs may write such comments."""
    try:
        value = float(text)
    except ValueError:
        return 1.0
    return value if math.isfinite(value) and value > 0 else 1.0
