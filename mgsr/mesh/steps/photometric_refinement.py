"""Refine the surface photometrically: move it to where the photographs agree."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config import MeshConfig
from mgsr.config.expert import PhotometricOptions
from mgsr.data.cost_factors import CostFactors
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult, reading_size
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photometric_refinement import refine_photometrically

# Seconds on the reference scene: of each turn under a flash, and of the only turn under other light.
FLASH_TURN, ONLY_TURN = 10.0, 6.0


@dataclass(frozen=True)
class PhotometricRefinement(MeshStep):
    """Move the surface to where the photographs agree, after the shape from shading of the same turn.

    It needs masks, because their contours keep the surface in place. The contours of given masks that contradict each
    other are not accurate enough for that.
    """

    refines = True
    turn: int = 1
    options: PhotometricOptions = field(default_factory=PhotometricOptions)

    @property
    def name(self) -> str:
        return "photometric_refinement" if self.turn == 1 else f"photometric_refinement_{self.turn}"

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        photos = context.photos
        wanted = context.config.photometric_reach is not None and bool(photos.silhouettes) and photos.margin == 0
        return light.searches == self.turn and wanted and context.go_on()

    def cost(self, factors: CostFactors, config: MeshConfig) -> float:
        held = factors.masked or factors.searched or factors.learned
        if config.max_light_residual is None or config.photometric_reach is None or not held:
            return 0.0
        if factors.flash:
            return FLASH_TURN * reading_size(factors, config)
        return ONLY_TURN * reading_size(factors, config) if self.turn == 1 else 0.0

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        reach = context.config.photometric_reach or 0.0
        moved = refine_photometrically(
            mesh, context.photos, reach, light.model, context.go_on, self.options, accurate=True
        )
        return StepResult(moved, light)
