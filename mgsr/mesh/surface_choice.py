"""The choice between the trained surface and the surface on which training began.

On a correct matte surface the photographs agree. On a correct mirroring surface one environment map explains them.
Training enforces neither: dents that imitate reflections have no cost.
"""

from __future__ import annotations

import numpy as np

from mgsr.config import ExpertConfig
from mgsr.config.expert import SurfaceChoiceOptions
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_residual import environment_residuals
from mgsr.shading.photo_set import PhotoSet
from mgsr.stereo.photo_consistency import photo_consistency
from mgsr.stereo.photographs import stereo_photographs


def is_torn(trained: Mesh, start: Mesh, tears: int = SurfaceChoiceOptions().tears) -> bool:
    """Return whether the trained surface has over `tears` more holes and handles than the surface at the start.

    Extraction leaves hundreds of them in sheets that are thinner than its cells.
    """
    return _openings(trained) > _openings(start) + tears


def _openings(mesh: Mesh) -> int:
    """Return the number of boundary loops plus twice the number of handles, by Euler's formula."""
    return 2 * mesh.components[0] - (len(np.unique(mesh.faces)) - len(mesh.edges) + len(mesh.faces))


def photographs_prefer_start(
    start: Mesh, trained: Mesh, photos: PhotoSet, mirroring: bool, expert: ExpertConfig = ExpertConfig()
) -> bool:
    """Return whether the photographs clearly prefer the surface on which training began.

    start, trained: in the scene's frame. mirroring: whether an environment map explains the photographs on `start`.
    Residuals under such a map are then compared, else photo-consistency. expert: the options of all algorithms.
    """
    light, choice = expert.shading.light, expert.mesh.choice
    if mirroring:
        residuals = environment_residuals((start, trained), photos, light.environment)
        on_start, on_trained = (each.ratio for each in residuals)
        return on_start <= choice.max_start_residual * on_trained
    prepared = stereo_photographs(photos.views, expert.stereo.max_object_pixels)
    before, after = (photo_consistency(prepared, surface.caster, expert.stereo.match) for surface in (start, trained))
    return before > after + choice.min_gain
