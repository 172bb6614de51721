"""The extracted surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgsr.shading.refine import Light


@dataclass(frozen=True)
class TexturedMesh:
    """vertices [V,3] float64, once for each chart of the picture that they lie on; faces [F,3] int64; normals [V,3]
    float32 unit; uvs [V,2] float32, 0..1 from the picture's upper left corner; picture [S,S,3] uint8 sRGB."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    picture: np.ndarray


@dataclass(frozen=True)
class Mesh:
    """vertices [V,3] float64, faces [F,3] int64 counter-clockwise from outside, normals [V,3] float32 unit and
    outward, colors [V,3] float32 sRGB 0..1; light: what lit the photographs, as far as they tell; a flash's
    shading refined it. parallax: whether theirs moved it; opened: the share of its area that was taken out, as they
    differed about it; textured: the same surface with a picture, where one was asked for; start_kept: whether
    it is the surface that training began on, as the photographs speak for it."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    light: Light = Light.UNKNOWN
    parallax: bool = False
    opened: float = 0.0
    textured: TexturedMesh | None = None
    start_kept: bool = False
