"""The extracted surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mgsr.shading.shape_from_shading import Light


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh with a texture.

    vertices [V,3] float64, once for each chart of the texture that they lie on; faces [F,3] int64; normals [V,3]
    float32 unit; uvs [V,2] float32, 0..1 from the texture's upper left corner; picture [S,S,3] uint8 sRGB: the texture.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    picture: np.ndarray


@dataclass(frozen=True)
class Mesh:
    """An extracted mesh with vertex colours.

    vertices [V,3] float64; faces [F,3] int64, counter-clockwise from outside; normals [V,3] float32, unit and outward;
    colors [V,3] float32 sRGB 0..1; light: what lit the photographs, as far as they tell; a flash's shading refined the
    mesh. photometric_refinement: whether photometric refinement moved it; removed_area: the share of its area that was
    removed, as the photographs contradict it; textured: the same surface with a texture, where one was asked for;
    start_kept: whether it is the surface that training began on, as the photographs speak for it.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    light: Light = Light.UNKNOWN
    photometric_refinement: bool = False
    removed_area: float = 0.0
    textured: TexturedMesh | None = None
    start_kept: bool = False
