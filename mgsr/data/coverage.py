"""The check whether there are enough photographs, close enough to each other, to reconstruct a surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import ViewCountOptions
from mgsr.data.scene import View


def note_of_few_views(
    views: Sequence[View], center: np.ndarray, masked: bool, options: ViewCountOptions = ViewCountOptions()
) -> str | None:
    """Return a note where the training views are too few or too far apart, else None.

    center: the point [3] that the cameras look at, in the views' frame. masked: whether silhouettes constrain the shape
    too.
    """
    count = len(views)
    alone = np.mean(_angles_to_nearest(views, center) > options.max_angle)
    if alone >= 0.5 and not masked:
        return (
            f"too few photographs: at least half of the {count} training photographs have no neighbour within "
            f"{options.max_angle:.0f} degrees, so depth is uncertain and the surface is a guess; take at least 20 that "
            "overlap"
        )
    if count < options.min_views:
        rough = "the surface is hardly better than the visual hull" if masked else "the surface is rough"
        return f"too few photographs: with {count} training photographs, {rough}; take at least 20 that overlap"
    return None


def _angles_to_nearest(views: Sequence[View], center: np.ndarray) -> np.ndarray:
    """Return the angle [V], degrees, between each view and its nearest neighbour, as seen from `center` [3]."""
    rays = np.array([view.camera.center - center for view in views])
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    cosines = rays @ rays.T
    np.fill_diagonal(cosines, -1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines.max(axis=1), -1, 1))))
