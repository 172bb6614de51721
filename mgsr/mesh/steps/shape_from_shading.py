"""Refine the surface by shape from shading.

A flash gives the normal of each point directly. Interreflection in concavities flattens the normals, so the large shape
stays that of training. Under an environment map, a normal also needs the observations of neighbours. The map improves
the first surface, but not a trained one: there, it only predicts the reflections for photometric refinement.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config import MeshConfig
from mgsr.config.expert import LightOptions, ShadingOptions, ShadingPass
from mgsr.data.cost_factors import CostFactors
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult, reading_size
from mgsr.shading.light_estimate import LightEstimate, estimate_light
from mgsr.shading.light_kind import LightKind
from mgsr.shading.shape_from_shading import shape_from_shading

# Seconds on the reference scene: of a round under a flash, and of the comparison of the light models.
FLASH_ROUND, COMPARISON = 10.0, 2.0


@dataclass(frozen=True)
class ShapeFromShading(MeshStep):
    """Estimate the light, and under a flash bend the surface to the normals that explain its shading.

    Each turn estimates the light again, because a better surface gives a better estimate. A turn after the first needs
    a flash.
    """

    refines = True
    rounds: ShadingPass
    turn: int = 1
    options: ShadingOptions = field(default_factory=ShadingOptions)
    light: LightOptions = field(default_factory=LightOptions)

    @property
    def name(self) -> str:
        return "shape_from_shading" if self.turn == 1 else f"shape_from_shading_{self.turn}"

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        if not context.photos.views or context.config.max_light_residual is None:
            return False
        return self.turn == 1 or (light.kind is LightKind.FLASH and context.go_on())

    def cost(self, factors: CostFactors, config: MeshConfig) -> float:
        if config.max_light_residual is None:
            return 0.0
        if factors.flash:
            return FLASH_ROUND * self.rounds.rounds * reading_size(factors, config)
        return COMPARISON * reading_size(factors, config) if factors.shiny and self.turn == 1 else 0.0

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        light = estimate_light(mesh, context.photos, context.config.max_light_residual or 0.0, light, self.light)
        passes = {LightKind.FLASH: (self.rounds,)}
        mesh = shape_from_shading(mesh, context.photos, light, passes, go_on=context.go_on, options=self.options)
        return StepResult(mesh, light, {"light": str(light.kind)})
