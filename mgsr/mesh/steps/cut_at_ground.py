"""Cut off the surface below the plane on which the object stands."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert.mesh_steps.cut_at_ground import CutAtGroundOptions
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class CutAtGround(MeshStep):
    """Drop the faces that lie wholly below the plane on which a found object stands.

    No photograph shows the object's underside, and silhouettes from above bound it only loosely.
    """

    name = "cut_at_ground"
    options: CutAtGroundOptions = field(default_factory=CutAtGroundOptions)

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return context.ground is not None

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        if context.ground is None:
            return StepResult(mesh, light)
        heights = mesh.vertices @ context.ground[:3] + context.ground[3]
        return StepResult(
            mesh.keep_faces((heights > -self.options.sunk * context.footprint)[mesh.faces].any(axis=1)), light
        )
