"""Pull the surface into the silhouettes."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert.mesh_steps.pull_into_hull import PullIntoHullOptions
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.cleanup import pull_into_hull
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class PullIntoHull(MeshStep):
    """Move vertices outside a silhouette inwards, and cut off faces that lie too far outside."""

    name = "pull_into_hull"
    options: PullIntoHullOptions = field(default_factory=PullIntoHullOptions)

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return context.hull is not None

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        config, hull = context.config, context.hull
        if hull is None or not len(mesh.faces):
            return StepResult(mesh, light)
        reach = config.hull_reach * context.footprint
        return StepResult(pull_into_hull(mesh, hull, config.hull_margin or 0, reach, self.options.rounds), light)
