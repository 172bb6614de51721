"""The meshes that a run makes: with vertex colours, and with a texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import StepReport
from mgsr.shading.light_estimate import LightKind


@dataclass(frozen=True, eq=False)
class TexturedMesh(Mesh):
    """A mesh with a texture, whose vertices come once for each chart of the texture that they lie on.

    uvs [V,2] float32, 0..1 from the texture's upper left corner; picture [S,S,3] uint8 sRGB: the texture.
    """

    uvs: np.ndarray
    picture: np.ndarray


@dataclass(frozen=True, eq=False)
class ReconstructedMesh(Mesh):
    """The mesh of a run, with vertex colours.

    vertices are float64, faces int64 and outward; colors [V,3] float32 sRGB 0..1; light: the light of the photographs,
    as far as they tell; start_kept: whether it is the surface that training began on, as the photographs speak for it;
    steps: what each step of its finishing did, by name; textured: the same surface with a texture, where one was asked
    for.
    """

    colors: np.ndarray
    light: LightKind = LightKind.UNKNOWN
    start_kept: bool = False
    steps: Mapping[str, StepReport] = field(default_factory=dict)
    textured: TexturedMesh | None = None

    def with_report(self, light: LightKind, start_kept: bool, steps: Mapping[str, StepReport]) -> ReconstructedMesh:
        """Return the mesh with what a report says of how it was made."""
        mesh = replace(self, light=light, start_kept=start_kept, steps=steps)
        return mesh.with_normals(self.normals)
