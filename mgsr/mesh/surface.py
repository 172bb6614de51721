"""The meshes of a run: the full surface with vertex colours, and a smaller one with a texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import StepReport
from mgsr.mesh.unwrap import UnwrappedMesh
from mgsr.shading.light_kind import LightKind
from mgsr.shading.material import Material


@dataclass(frozen=True, eq=False)
class TexturedMesh(UnwrappedMesh):
    """An unwrapped mesh with a physically based material (metallic and roughness, as in glTF).

    base_color [H,W,3]: uint8 sRGB.
    normal_map [H,W,3]: uint8, tangent space, 0..255 for -1..1.
    occlusion [H,W]: uint8, the visible share of the sky.
    material: the properties that are the same on the whole surface.
    """

    base_color: np.ndarray
    normal_map: np.ndarray
    occlusion: np.ndarray
    material: Material


@dataclass(frozen=True, eq=False)
class ReconstructedMesh(Mesh):
    """The mesh of a run, with vertex colours.

    vertices are float64, and faces int64 and outward. colors [V,3]: float32 sRGB 0..1. light: the kind of light in the
    photographs. start_kept: whether the surface on which training began replaced the trained one. steps: the reports of
    the finishing steps, by name.
    """

    colors: np.ndarray
    light: LightKind = LightKind.UNKNOWN
    start_kept: bool = False
    steps: Mapping[str, StepReport] = field(default_factory=dict)

    def with_report(self, light: LightKind, start_kept: bool, steps: Mapping[str, StepReport]) -> ReconstructedMesh:
        """Return the mesh with the given light, choice of surface and step reports."""
        mesh = replace(self, light=light, start_kept=start_kept, steps=steps)
        return mesh.with_normals(self.normals)
