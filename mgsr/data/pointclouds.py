"""Point clouds that captures bring along as PLY."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError, in_short


def read_points(path: Path) -> PointCloud:
    """The finite vertices of a PLY and their colours, grey where it has none. Raises SceneError naming the file."""
    from plyfile import PlyData, PlyParseError  # late: training needs no PLY

    try:
        vertex = PlyData.read(str(path))["vertex"]
        positions = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=1)
        colors = _colors(vertex, len(positions))
    except (PlyParseError, KeyError, ValueError, TypeError, IndexError, OverflowError, OSError, MemoryError) as error:
        raise SceneError(
            f"{path.name}: expected a PLY with vertices: {in_short(error)}; export it again or remove it"
        ) from error
    finite = np.isfinite(positions).all(axis=1)
    return PointCloud(positions[finite], colors[finite])


def _colors(vertex: Any, count: int) -> np.ndarray:
    if not {"red", "green", "blue"} <= {item.name for item in vertex.properties}:
        return np.full((count, 3), 128, np.uint8)
    return np.stack([np.asarray(vertex[name], np.uint8) for name in ("red", "green", "blue")], axis=1)
