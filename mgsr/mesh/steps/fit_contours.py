"""Register the surface to the masks' silhouette contours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from mgsr.config.expert import ContourOptions
from mgsr.geometry.contours import fit_contours
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate


@dataclass(frozen=True)
class FitContours(MeshStep):
    """Move the surface so that its silhouette contours fall on the masks'."""

    name = "fit_contours"
    options: ContourOptions = field(default_factory=ContourOptions)

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        return bool(context.photos.silhouettes) and context.config.silhouette_smoothing is not None

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        smoothing, options = context.config.silhouette_smoothing or 0.0, self.options
        if context.photos.masks_inexact:
            smoothing *= options.inexact_smoothing
            options = replace(options, prior_weight=options.inexact_prior_weight)
        return StepResult(fit_contours(mesh, context.photos.contours, smoothing, options), light)
