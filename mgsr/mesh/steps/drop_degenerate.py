"""Drop degenerate faces."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import drop_degenerate
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class DropDegenerate(MeshStep):
    """Drop faces that repeat a vertex, have no area or are not finite."""

    name = "drop_degenerate"

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        mesh = drop_degenerate(mesh)
        context.require_faces(mesh, "no face remains after the fusion")
        return StepResult(mesh, light)
