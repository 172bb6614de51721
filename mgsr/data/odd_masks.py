"""Views whose masks contradict the others': inverted, of another view, or of something that hides the object."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np

from mgsr.data.hull import view_field
from mgsr.data.normalise import ball_of_masks
from mgsr.data.scene import View
from mgsr.data.silhouettes import Silhouette
from mgsr.parallel import map_ahead

# With few views, correct masks also disagree much about the object's place.
FEWEST = 6

# A point belongs to the object if at most this share of the views, or one view, has it outside its mask.
DISSENT = 0.1

# A mask contradicts the others if it excludes this share of such points. Of 6 good ones of the shared scenes none
# leaves out more than 0.24, of 12 more than 0.05; inverted ones leave out 0.7 and more, those a third of the image
# beside the object 0.55 and more of 12.
MOST_LEFT_OUT = 0.5

# Where more than this share of the views contradict, it is unknown which are right.
MOST_ODD = 0.25

# Points along each side of the sampled cube around the object.
_SIDE = 32


def agreeing_masks(views: Sequence[View], outlines: Sequence[Silhouette]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return which views to keep, [V] bool, and a note on the others.

    The few views to leave out have masks that exclude points inside nearly all other masks. views: in the user's
    frame. outlines: their silhouettes, of masks that are not empty; none without masks.
    """
    agreeing = np.ones(len(views), dtype=bool)
    if len(outlines) < FEWEST:
        return agreeing, ()
    odd = left_out_shares(views, outlines) > MOST_LEFT_OUT
    if not 0 < odd.sum() <= MOST_ODD * len(views):
        return agreeing, ()
    names = ", ".join(repr(view.name) for view in compress(views, odd))
    text = f"the masks of {odd.sum()} of {len(views)} training views exclude places that the others count as the object"
    return ~odd, (f"{text} ({names}); these views are skipped",)


def left_out_shares(views: Sequence[View], outlines: Sequence[Silhouette]) -> np.ndarray:
    """Return the share of the object, as nearly all masks have it, that each view's mask leaves out, [V].

    views: with masks that are not empty; outlines: their silhouettes.
    """
    left_out = _left_out(views, outlines)
    votes = left_out.sum(axis=0)
    objects = votes <= max(votes.min(), 1, DISSENT * len(views))
    return np.asarray(left_out[:, objects].mean(axis=1))


def _left_out(views: Sequence[View], outlines: Sequence[Silhouette]) -> np.ndarray:
    """Return which points of a grid around the object each view has outside its mask, [V,P] bool."""
    center, radii = ball_of_masks(views)
    axis = np.linspace(-1, 1, _SIDE) * np.median(radii)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + center
    fields = map_ahead(lambda outline: view_field(outline, points), outlines, None)
    return np.array([tells & (distance < 0) for tells, distance in fields])
