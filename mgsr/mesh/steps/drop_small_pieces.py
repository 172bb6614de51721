"""Drop small connected pieces, such as floaters."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import drop_small_pieces
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class DropSmallPieces(MeshStep):
    """Drop connected pieces under the share `mesh.min_piece` of the whole area."""

    name = "drop_small_pieces"

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        return StepResult(drop_small_pieces(mesh, context.config.min_piece), light)
