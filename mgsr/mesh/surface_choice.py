"""The choice between the trained surface and the one that training began on.

A surface that is right lets the photographs agree about what lies on it, or, where it mirrors what surrounds it, lets
one environment map explain them. Training has no such check of its own: dents that imitate reflections cost it nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.data.scene import View
from mgsr.geometry.displace import edges
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import Triangles, face_components
from mgsr.shading.environment_residual import environment_residuals
from mgsr.shading.shape_from_shading import MIRRORS
from mgsr.stereo.photo_consistency import photo_consistency
from mgsr.stereo.photographs import stereo_photographs

CLEARLY = 0.95  # of what they leave on the trained surface, at or under which the start is better
TEARS = 40  # holes and handles, the latter counted twice; a torn surface has hundreds, others few
BETTER = 0.02  # of correlation by which the start must exceed the trained surface


def is_torn(trained: Triangles, start: Triangles) -> bool:
    """Return whether the trained surface has TEARS more holes and handles than the one that training began on.

    Where sheets are thinner than the cells of its extraction, it is torn into hundreds.
    """
    return _openings(*trained) > _openings(*start) + TEARS


def _openings(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Return the number of boundary loops and twice that of handles, by Euler's formula."""
    pieces, _ = face_components(faces, len(vertices))
    return 2 * pieces - (len(np.unique(faces)) - len(edges(faces)) + len(faces))


def photographs_prefer_start(start: Triangles, trained: Triangles, photographs: Sequence[View]) -> bool:
    """Return whether the photographs speak clearly for the surface that training began on.

    start, trained: vertices [V,3] in the scene's frame and faces [F,3].
    """
    on_start, on_trained = (each.ratio for each in environment_residuals((start, trained), photographs))
    if on_start <= MIRRORS:
        return on_start <= CLEARLY * on_trained
    prepared = stereo_photographs(photographs)
    before, after = (photo_consistency(prepared, RayCaster(*surface)) for surface in (start, trained))
    return before > after + BETTER
