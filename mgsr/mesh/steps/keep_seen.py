"""Turn the surface outwards, and keep what a camera sees of it."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.geometry.mesh import Mesh
from mgsr.mesh.cleanup import drop_unseen, seen_sides, turn_outwards
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class KeepSeen(MeshStep):
    """Turn pieces that are mostly seen from the back, and drop what no rendered view sees."""

    name = "keep_seen"

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        sides = seen_sides(mesh, context.views, gap=context.footprint)
        mesh = drop_unseen(turn_outwards(mesh, sides), sides != 0, whole_pieces=context.config.close_holes)
        context.require_faces(mesh, "no camera sees any of the surface")
        return StepResult(mesh, light)
