"""Numbers that MGSR keeps in the header of a PLY, so that later steps find them again: the file's unit, and what its
splats must be drawn with."""

from __future__ import annotations

import math
from pathlib import Path

UNIT = "unit"  # what the lengths are multiplied with against the capture's
LOW_PASS = "low_pass"  # px^2, see `VolumeModel`
# What a file means that does not say: other programs' splats are drawn with 3DGS's low-pass.
_UNSAID = {UNIT: 1.0, LOW_PASS: 0.3}
_LONGEST_HEADER = 1 << 16


def number_comments(**numbers: float | None) -> list[str]:
    """The header's comments for numbers by their names; none for what goes without saying, and for None."""
    said = {name: value for name, value in numbers.items() if value not in (None, _UNSAID[name])}
    return [f"mgsr {name} {value!r}" for name, value in said.items()]


def read_number(path: Path, name: str) -> float:
    """A number of a PLY's header; what goes without saying where it is not there."""
    with path.open("rb") as file:
        header = file.read(_LONGEST_HEADER).partition(b"end_header")[0]
    for line in header.decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:3] == ["comment", "mgsr", name] and len(words) == 4:
            return _positive(words[3], _UNSAID[name])
    return _UNSAID[name]


def _positive(text: str, otherwise: float) -> float:
    """`otherwise` for what is no number above 0: other programs may write such comments."""
    try:
        value = float(text)
    except ValueError:
        return otherwise
    return value if math.isfinite(value) and value > 0 else otherwise
