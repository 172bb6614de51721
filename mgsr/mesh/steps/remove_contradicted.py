"""Remove patches that the photographs contradict, such as covers of holes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mgsr.config.expert import ResidualOptions
from mgsr.config.expert.mesh_steps.remove_contradicted import RemoveContradictedOptions
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.triangles import drop_small_pieces
from mgsr.mesh.steps.step import MeshStep, StepContext, StepResult
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.light_kind import LightKind
from mgsr.shading.photometric_residual import photometric_residual


@dataclass(frozen=True)
class RemoveContradicted(MeshStep):
    """Remove patches with a large photometric residual under a flash.

    In such a patch the residual is everywhere above a share of `mesh.photometric_residual`, and somewhere above it.
    """

    name = "remove_contradicted"
    refines = True
    options: RemoveContradictedOptions = field(default_factory=RemoveContradictedOptions)
    residual: ResidualOptions = field(default_factory=ResidualOptions)

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        config = context.config
        wanted = config.photometric_residual is not None and not config.close_holes
        return light.kind is LightKind.FLASH and wanted and context.go_on()

    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        most = context.config.photometric_residual
        assert light.model is not None and most is not None
        residual = photometric_residual(mesh, context.photos, light.model, self.residual)[mesh.faces].max(axis=1)
        areas = np.linalg.norm(mesh.face_crosses, axis=1) / 2
        gone = self._contradicted(mesh, residual, areas, most, context.photos.pixel_on(mesh) ** 2)
        removed = float(areas[gone].sum() / areas.sum())
        kept = np.ones(len(mesh.faces), bool)
        kept[gone] = False
        mesh = mesh.keep_faces(kept)
        if removed:
            mesh = drop_small_pieces(mesh, context.config.min_piece)
        return StepResult(mesh, light, {"removed_area": removed})

    def _contradicted(
        self, mesh: Mesh, residual: np.ndarray, areas: np.ndarray, most: float, pixel_area: float
    ) -> np.ndarray:
        """Return the indices of the faces to remove. residual, areas [F]: of the faces."""
        doubted = np.flatnonzero(residual > most * self.options.share)
        count, patches = Mesh(mesh.vertices, mesh.faces[doubted]).components
        certain = np.bincount(patches, residual[doubted] > most, count) > 0
        large = np.bincount(patches, areas[doubted], count) > pixel_area * self.options.min_pixels
        return np.asarray(doubted[(certain & large)[patches]])
