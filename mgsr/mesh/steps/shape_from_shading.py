"""Refine the surface by shape from shading.

Under a flash, the brightness of each point determines its own normal. The large shape is kept from training, because
interreflection makes shading flatten concavities.

Under an environment map, a normal also needs the observations of neighbouring points. Such normals improve the first
surface on the visual hull, but not a trained surface. On a trained surface, the step therefore only estimates the map.
Photometric refinement uses the map to weight reflected detail less.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config import MeshConfig
from mgsr.config.expert import LightOptions, ShadingOptions, ShadingPass
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, SceneFacts, StepContext, StepResult, reading_size
from mgsr.shading.light_estimate import LightEstimate, LightKind, estimate_light
from mgsr.shading.shape_from_shading import shape_from_shading


@dataclass(frozen=True)
class ShapeFromShading(MeshStep):
    """Estimate the light, and under a flash bend the surface to the normals that explain its shading.

    Each turn estimates the light again, because a better surface gives a better estimate. Turns after the first need a
    flash.
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

    def cost(self, facts: SceneFacts, config: MeshConfig) -> float:
        if config.max_light_residual is None:
            return 0.0
        if facts.flash:
            return 10.0 * self.rounds.rounds * reading_size(facts, config)
        return 2.0 * reading_size(facts, config) if facts.shiny and self.turn == 1 else 0.0

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        light = estimate_light(mesh, context.photos, context.config.max_light_residual or 0.0, light, self.light)
        passes = {LightKind.FLASH: (self.rounds,)}
        mesh = shape_from_shading(mesh, context.photos, light, passes, go_on=context.go_on, options=self.options)
        return StepResult(mesh, light, {"light": str(light.kind)})
