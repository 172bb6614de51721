"""The choice between the trained surface and the surface on which training began.

On a correct surface the photographs are consistent or, if it mirrors its surroundings, one environment map explains
them. Training does not enforce this: dents that imitate reflections have no cost.
"""

from __future__ import annotations

import numpy as np

from mgsr.config import ExpertConfig
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_residual import environment_residuals
from mgsr.shading.photo_set import PhotoSet
from mgsr.stereo.photo_consistency import photo_consistency
from mgsr.stereo.photographs import stereo_photographs

CLEARLY = 0.95  # the start is better if its environment residual is at most this share of the trained surface's
TEARS = 40  # boundary loops plus twice the handles; a torn surface has hundreds, others have few
BETTER = 0.02  # photo-consistency by which the start must exceed the trained surface


def is_torn(trained: Mesh, start: Mesh) -> bool:
    """Return whether the trained surface has over TEARS more holes and handles than the surface at the start.

    Extraction leaves hundreds of them in sheets that are thinner than its cells.
    """
    return _openings(trained) > _openings(start) + TEARS


def _openings(mesh: Mesh) -> int:
    """Return the number of boundary loops plus twice the number of handles, by Euler's formula."""
    return 2 * mesh.components[0] - (len(np.unique(mesh.faces)) - len(mesh.edges) + len(mesh.faces))


def photographs_prefer_start(
    start: Mesh, trained: Mesh, photos: PhotoSet, expert: ExpertConfig = ExpertConfig()
) -> bool:
    """Return whether the photographs clearly prefer the surface on which training began.

    start, trained: in the scene's frame. expert: the options of all algorithms.
    """
    light = expert.shading.light
    on_start, on_trained = (each.ratio for each in environment_residuals((start, trained), photos, light.environment))
    if on_start <= light.max_environment_ratio:
        return on_start <= CLEARLY * on_trained
    prepared = stereo_photographs(photos.views, expert.stereo.max_object_pixels)
    before, after = (photo_consistency(prepared, surface.caster, expert.stereo.match) for surface in (start, trained))
    return before > after + BETTER
