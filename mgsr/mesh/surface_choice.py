"""The choice between the trained surface and the one that training began on.

A surface that is right lets the photographs agree about what lies on it, or, where it mirrors what surrounds it, lets
one environment map explain them. Training has no such check of its own: dents that imitate reflections cost it nothing.
"""

from __future__ import annotations

import numpy as np

from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_residual import environment_residuals
from mgsr.shading.light_estimate import MAX_ENVIRONMENT_RATIO
from mgsr.shading.photo_set import PhotoSet
from mgsr.stereo.photo_consistency import photo_consistency
from mgsr.stereo.photographs import stereo_photographs

CLEARLY = 0.95  # of what they leave on the trained surface, at or under which the start is better
TEARS = 40  # holes and handles, the latter counted twice; a torn surface has hundreds, others few
BETTER = 0.02  # of correlation by which the start must exceed the trained surface


def is_torn(trained: Mesh, start: Mesh) -> bool:
    """Return whether the trained surface has TEARS more holes and handles than the one that training began on.

    Where sheets are thinner than the cells of its extraction, it is torn into hundreds.
    """
    return _openings(trained) > _openings(start) + TEARS


def _openings(mesh: Mesh) -> int:
    """Return the number of boundary loops and twice that of handles, by Euler's formula."""
    return 2 * mesh.components[0] - (len(np.unique(mesh.faces)) - len(mesh.edges) + len(mesh.faces))


def photographs_prefer_start(start: Mesh, trained: Mesh, photos: PhotoSet) -> bool:
    """Return whether the photographs speak clearly for the surface that training began on.

    start, trained: in the scene's frame.
    """
    on_start, on_trained = (each.ratio for each in environment_residuals((start, trained), photos))
    if on_start <= MAX_ENVIRONMENT_RATIO:
        return on_start <= CLEARLY * on_trained
    prepared = stereo_photographs(photos.views)
    before, after = (photo_consistency(prepared, surface.caster) for surface in (start, trained))
    return before > after + BETTER
