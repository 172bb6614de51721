"""The search for masks that contradict the others: inverted, of another view, or of something that hides the object."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np
from scipy import ndimage

from mgsr.config.expert import OddMaskOptions
from mgsr.data.hull import view_field
from mgsr.data.normalise import ball_of_masks
from mgsr.data.scene import View
from mgsr.data.silhouettes import Silhouette
from mgsr.parallel import map_ahead


def agreeing_masks(
    views: Sequence[View], silhouettes: Sequence[Silhouette], options: OddMaskOptions = OddMaskOptions()
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return which views to keep, [V] bool, and a note on the others.

    The few views to leave out have masks that exclude points inside nearly all other masks. views: in the user's
    frame. silhouettes: their silhouettes, of masks that are not empty; none without masks.
    """
    agreeing = np.ones(len(views), dtype=bool)
    if len(silhouettes) < options.min_views:
        return agreeing, ()
    odd = left_out_shares(views, silhouettes, options.left_out, options) > options.left_out
    if not 0 < odd.sum() <= options.max_odd * len(views):
        return agreeing, ()
    names = ", ".join(repr(view.name) for view in compress(views, odd))
    text = f"the masks of {odd.sum()} of {len(views)} training views exclude places that the others count as the object"
    return ~odd, (f"{text} ({names}); these views are skipped",)


def left_out_shares(
    views: Sequence[View], silhouettes: Sequence[Silhouette], least: float, options: OddMaskOptions = OddMaskOptions()
) -> np.ndarray:
    """Return the share [V] of the object, as nearly all masks show it, that each view's mask leaves out.

    A view along a thin part, such as a plate, is the only one that shows how thin the part is. Its mask correctly
    leaves out much, and the other masks do not need the part that it leaves out. A share above `least` therefore counts
    as 0 if the other masks need none of it.

    views: with masks that are not empty; silhouettes: their silhouettes.
    """
    points, spacing = _grid(views, options.places)
    left_out = _left_out(points, silhouettes)
    votes = left_out.sum(axis=0)
    objects = votes <= max(votes.min(), 1, options.dissent * len(views))
    shares = left_out[:, objects].mean(axis=1)
    much = np.flatnonzero(shares > least).tolist()
    if much:
        # A part that is thinner than the spacing may have no point inside.
        wider = _left_out(points[objects], [silhouettes[index] for index in much], spacing / 2)
        cells = [_cells(view, points[objects], spacing) for view in views]
        for index, wide in zip(much, wider, strict=True):
            if _needed(wide, cells[:index] + cells[index + 1 :]) < options.needed:
                shares[index] = 0
    return np.asarray(shares)


def _grid(views: Sequence[View], side: int) -> tuple[np.ndarray, float]:
    """Return points [P,3] of a grid around the object, and their spacing. side: the points along each side."""
    center, radii = ball_of_masks(views)
    axis = np.linspace(-1, 1, side) * np.median(radii)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + center
    return points, float(axis[1] - axis[0])


def _left_out(points: np.ndarray, silhouettes: Sequence[Silhouette], far: float = 0.0) -> np.ndarray:
    """Return which points [P,3] each view has farther than `far` outside its mask, [V,P] bool."""
    fields = map_ahead(lambda silhouette: view_field(silhouette, points), silhouettes, None)
    return np.array([constrained & (distance < -far) for constrained, distance in fields])


def _cells(view: View, points: np.ndarray, spacing: float) -> np.ndarray:
    """Return the cell [P,2] of a view's image that shows each point [P,3]; a cell is as wide as the points' spacing."""
    pixels, depth = view.camera.project(points)
    width = view.camera.K[0, 0] * spacing / max(float(np.median(depth)), 1e-9)
    return np.asarray(np.floor(np.clip(pixels, 0, (view.camera.width, view.camera.height)) / width).astype(np.int64))


def _needed(left_out: np.ndarray, cells: Sequence[np.ndarray]) -> float:
    """Return the share, 0..1, of the points left out by a view, left_out [P] bool, that the other masks need.

    A mask needs a point if none of the points that the view keeps lies before or behind it. cells [P,2]: for each other
    view, the points' cells.
    """
    needed = []
    for cell in cells:
        low = cell.min(axis=0) - 1
        filled = np.zeros(cell.max(axis=0) - low + 2, bool)
        filled[tuple((cell[~left_out] - low).T)] = True
        around = ndimage.binary_dilation(filled, np.ones((3, 3)))
        needed.append(~around[tuple((cell[left_out] - low).T)])
    return float(np.mean(needed)) if left_out.any() else 0.0
