"""The meshes of a run: with vertex colours, and with a texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import StepReport
from mgsr.shading.light_estimate import LightKind


@dataclass(frozen=True, eq=False)
class TexturedMesh(Mesh):
    """A mesh with a texture. A vertex on several charts of the texture is repeated for each.

    uvs [V,2]: float32 texture coordinates, 0..1 from the upper left corner. picture [S,S,3]: the texture, uint8 sRGB.
    """

    uvs: np.ndarray
    picture: np.ndarray


@dataclass(frozen=True, eq=False)
class ReconstructedMesh(Mesh):
    """The mesh of a run, with vertex colours.

    vertices are float64, and faces int64 and outward. colors [V,3]: float32 sRGB 0..1. light: the kind of light in the
    photographs. start_kept: whether the surface on which training began replaced the trained one. steps: the reports of
    the finishing steps, by name. textured: the same surface with a texture, None unless requested.
    """

    colors: np.ndarray
    light: LightKind = LightKind.UNKNOWN
    start_kept: bool = False
    steps: Mapping[str, StepReport] = field(default_factory=dict)
    textured: TexturedMesh | None = None

    def with_report(self, light: LightKind, start_kept: bool, steps: Mapping[str, StepReport]) -> ReconstructedMesh:
        """Return the mesh with the given light, choice of surface and step reports."""
        mesh = replace(self, light=light, start_kept=start_kept, steps=steps)
        return mesh.with_normals(self.normals)
