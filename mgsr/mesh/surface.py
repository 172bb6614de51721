"""The extracted surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgsr.shading.refine import Light


@dataclass(frozen=True)
class SurfaceMesh:
    """vertices [V,3] float64, faces [F,3] int64 counter-clockwise from outside, normals [V,3] float32 unit and
    outward, colors [V,3] float32 sRGB 0..1; light: whose shading refined it, unknown if none did."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    light: Light = Light.UNKNOWN
