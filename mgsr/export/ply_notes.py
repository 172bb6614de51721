"""Numbers that MGSR keeps in the header of a PLY, so that later steps find them.

They are the file's unit, the low-pass of its splats, and the origin of its positions where it differs from the frame's
(see `far_origin.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mgsr.export.far_origin import no_origin, origin_text, read_origin_text

UNIT = "unit"  # factor of the lengths relative to the capture's
LOW_PASS = "low_pass"  # px^2, see `GaussianModel`
ORIGIN = "origin"  # added to positions to get the frame's, in the file's unit
# The low-pass of a file without a note: other programs' splats use that of 3DGS.
_UNSAID = {UNIT: 1.0, LOW_PASS: 0.3}
_LONGEST_HEADER = 1 << 16


def number_comments(**numbers: float | None) -> list[str]:
    """Return the header's comments for numbers by their names; none for default values and for None."""
    said = {name: value for name, value in numbers.items() if value not in (None, _UNSAID[name])}
    return [f"mgsr {name} {value!r}" for name, value in said.items()]


def origin_comments(origin: np.ndarray | None) -> list[str]:
    """Return the header's comment for an origin [3]; none for the frame's own origin, zeros or None."""
    return [] if origin is None or not origin.any() else [f"mgsr {ORIGIN} {origin_text(origin)}"]


def read_number(path: Path, name: str) -> float:
    """Return a number of a PLY's header; its default where the header has none."""
    values = next((values for values in _notes(path, name) if len(values) == 1), None)
    return _UNSAID[name] if values is None else _positive(values[0], _UNSAID[name])


def read_origin(path: Path) -> np.ndarray:
    """Return the origin [3] that a PLY's header names, zeros where it names none.

    Raises SceneError, naming the file, for anything but three finite numbers.
    """
    values = next(_notes(path, ORIGIN), None)
    return no_origin() if values is None else read_origin_text(values, str(path))


def _notes(path: Path, name: str) -> Iterator[list[str]]:
    """Yield the words after the name in each such comment of a PLY's header."""
    with path.open("rb") as file:
        header = file.read(_LONGEST_HEADER).partition(b"end_header")[0]
    for line in header.decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:3] == ["comment", "mgsr", name]:
            yield words[3:]


def _positive(text: str, otherwise: float) -> float:
    """Return a text's number if it is above 0, else `otherwise`, as other programs may write such comments."""
    try:
        value = float(text)
    except ValueError:
        return otherwise
    return value if math.isfinite(value) and value > 0 else otherwise
