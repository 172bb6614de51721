"""Close holes."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.cleanup import close_loops
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class CloseHoles(MeshStep):
    """Close every boundary loop by a fan of faces, where `mesh.close_holes` asks for it."""

    name = "close_holes"

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return context.config.close_holes

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        return StepResult(close_loops(mesh), light)
