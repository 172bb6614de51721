"""Smooth low-frequency waves, which training leaves where photographs tell little."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config import MeshConfig
from mgsr.config.expert import LowFrequencyOptions
from mgsr.data.cost_factors import CostFactors
from mgsr.geometry.low_frequency import smooth_low_frequency
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult, surface_cells
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.light_kind import LightKind

SMOOTHING = 2.5  # seconds on the reference scene


@dataclass(frozen=True)
class SmoothLowFrequency(MeshStep):
    """Smooth shallow waves of a few of the photographs' pixels. Under a flash, shading separates them from shape."""

    name = "smooth_low_frequency"
    options: LowFrequencyOptions = field(default_factory=LowFrequencyOptions)

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        wanted = bool(context.config.regression_angle and context.photos.views)
        return wanted and light.kind is not LightKind.FLASH

    def cost(self, factors: CostFactors, config: MeshConfig) -> float:
        applies = config.regression_angle and not factors.flash
        return SMOOTHING * surface_cells(factors, config) ** 2 if applies else 0.0

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        angle = context.config.regression_angle or 0.0
        return StepResult(smooth_low_frequency(mesh, context.photos.pixel_on(mesh), angle, self.options), light)
