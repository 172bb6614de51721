"""Smooth the noise of the faces' normals."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert import BilateralOptions
from mgsr.geometry.bilateral_filter import bilateral_normal_filter
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class BilateralFilter(MeshStep):
    """Filter the faces' normals, and keep creases."""

    name = "bilateral_filter"
    options: BilateralOptions = field(default_factory=BilateralOptions)

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return bool(context.config.bilateral_angle)

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        return StepResult(bilateral_normal_filter(mesh, context.config.bilateral_angle or 0.0, self.options), light)
