"""Simplify the mesh."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.geometry.decimate import decimate
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class Decimate(MeshStep):
    """Reduce the mesh to `mesh.max_faces` faces."""

    name = "decimate"

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return context.config.max_faces is not None

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        return StepResult(decimate(mesh, context.config.max_faces or len(mesh.faces)), light)
