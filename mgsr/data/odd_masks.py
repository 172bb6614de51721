"""Views whose masks contradict the others': inverted, of another view, or of something that hides the object."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np

from mgsr.config.expert import OddMaskOptions
from mgsr.data.hull import view_field
from mgsr.data.normalise import ball_of_masks
from mgsr.data.scene import View
from mgsr.data.silhouettes import Silhouette
from mgsr.parallel import map_ahead


def agreeing_masks(
    views: Sequence[View], outlines: Sequence[Silhouette], options: OddMaskOptions = OddMaskOptions()
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return which views to keep, [V] bool, and a note on the others.

    The few views to leave out have masks that exclude points inside nearly all other masks. views: in the user's
    frame. outlines: their silhouettes, of masks that are not empty; none without masks.
    """
    agreeing = np.ones(len(views), dtype=bool)
    if len(outlines) < options.min_views:
        return agreeing, ()
    odd = left_out_shares(views, outlines, options) > options.left_out
    if not 0 < odd.sum() <= options.max_odd * len(views):
        return agreeing, ()
    names = ", ".join(repr(view.name) for view in compress(views, odd))
    text = f"the masks of {odd.sum()} of {len(views)} training views exclude places that the others count as the object"
    return ~odd, (f"{text} ({names}); these views are skipped",)


def left_out_shares(
    views: Sequence[View], outlines: Sequence[Silhouette], options: OddMaskOptions = OddMaskOptions()
) -> np.ndarray:
    """Return the share of the object, as nearly all masks have it, that each view's mask leaves out, [V].

    views: with masks that are not empty; outlines: their silhouettes.
    """
    left_out = _left_out(views, outlines, options.places)
    votes = left_out.sum(axis=0)
    objects = votes <= max(votes.min(), 1, options.dissent * len(views))
    return np.asarray(left_out[:, objects].mean(axis=1))


def _left_out(views: Sequence[View], outlines: Sequence[Silhouette], side: int) -> np.ndarray:
    """Return which points of a grid around the object each view has outside its mask, [V,P] bool.

    side: the points along each side of the grid.
    """
    center, radii = ball_of_masks(views)
    axis = np.linspace(-1, 1, side) * np.median(radii)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + center
    fields = map_ahead(lambda outline: view_field(outline, points), outlines, None)
    return np.array([tells & (distance < 0) for tells, distance in fields])
