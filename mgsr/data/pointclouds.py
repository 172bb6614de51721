"""Read point clouds that captures bring along as PLY."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.images import to_uint8
from mgsr.data.odd_files import require_content
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError, in_short

# The property names of vertex colours: in most programs; in MeshLab's older releases; in splats, as the constant
# spherical harmonic.
_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_HARMONIC = ("f_dc_0", "f_dc_1", "f_dc_2")
_SH_C0 = 0.28209479177387814
_GREY = 128.0
# Floats up to this are light from 0 to 1, partly over-exposed.
_BRIGHTEST = 2.0


def read_points(path: Path) -> PointCloud:
    """Read the finite vertices [P,3] of a PLY and their colours [P,3] uint8, grey where it has none.

    Colours are bytes, 16-bit numbers, or floats from 0 to 1, 255 or 65535, told apart by the largest. Raises SceneError
    naming the file.
    """
    from plyfile import PlyData, PlyParseError  # imported here, because training reads no PLY files

    require_content(path)
    try:
        vertex = PlyData.read(str(path))["vertex"]
        positions = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=1)
        colors = _colors(vertex, len(positions))
    except (PlyParseError, KeyError, ValueError, TypeError, IndexError, OverflowError, OSError, MemoryError) as error:
        raise SceneError(
            f"{path.name}: expected a PLY file with vertices: {in_short(error)}; export it again or remove it"
        ) from error
    finite = np.isfinite(positions).all(axis=1)
    return PointCloud(positions[finite], colors[finite])


def _colors(vertex: Any, count: int) -> np.ndarray:
    """Return the vertices' colours [count,3] uint8, grey where they have none."""
    there = {item.name for item in vertex.properties}
    names = next((names for names in (*_NAMES, _HARMONIC) if set(names) <= there), None)
    if names is None or count == 0:
        return np.full((count, 3), _GREY).astype(np.uint8)
    values = np.stack([np.asarray(vertex[name]) for name in names], axis=1)
    if names == _HARMONIC:
        values = np.clip(values * _SH_C0 + 0.5, 0, 1)
    return _as_bytes(values)


def _as_bytes(values: np.ndarray) -> np.ndarray:
    """Convert colours [P,3] of any numeric type to uint8; values that are not finite become grey."""
    if values.dtype == np.uint8:
        return values
    colors = values.astype(np.float64)
    largest = np.nanmax(np.where(np.isfinite(colors), colors, np.nan), initial=0)
    if largest > 255:
        colors = colors / 257
    elif largest <= _BRIGHTEST and values.dtype.kind == "f":
        colors = colors * 255
    return to_uint8(np.where(np.isfinite(colors), colors, _GREY))
