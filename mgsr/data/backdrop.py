"""The colour behind everything: white, black, or that of a plain backdrop in the photographs.

Without masks, splats must reproduce everything that photographs show. Around an object on black velvet or before white
paper they would build a curtain, which would end up in the mesh. As the colour behind the splats, a plain backdrop
costs none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mgsr.config import Background

if TYPE_CHECKING:
    from mgsr.data.scene import PointCloud, Scene, View

Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)
BLACK: Color = (0.0, 0.0, 0.0)

SIDE = 200  # pixels; of larger photographs only every so many-th row and column is looked at
BORDER = 0.03  # of a photograph's shorter side
PLAIN, MOST = 16, 0.9  # a backdrop is plain where so many border pixels are this near, of 255, to their median
DIFFERENT, SOME = 48, 0.02  # and so many others are this far from it: else all that there is has that colour
NEAR = 24  # what is nearer, of 255, to the backdrop's colour is taken for it


@dataclass(frozen=True)
class Backdrop:
    """The colour behind the splats, sRGB 0..1.

    random: training draws another colour in each iteration, and `color` is the one that renderings are judged on.
    plain: the photographs show this backdrop, so whatever has its colour is taken for it.
    """

    color: Color
    random: bool = False
    plain: bool = False


def backdrop(scene: Scene, kind: Background) -> Backdrop:
    """Choose the backdrop of a scene's splats from the background setting, the masks and the photographs."""
    if kind is Background.RANDOM or (kind is Background.AUTO and scene.masked):
        return Backdrop(WHITE, random=True)
    if kind is Background.AUTO and scene.plain_backdrop is not None:
        return Backdrop(scene.plain_backdrop, plain=True)
    return Backdrop(BLACK if kind is Background.BLACK else WHITE)


def plain_backdrop(views: Sequence[View]) -> Color | None:
    """Find the colour, sRGB 0..1, that nearly all borders of the photographs share.

    Returns None where the borders have no such colour, or where nothing else stands before it. It reads all
    photographs; `Scene.plain_backdrop` caches the result.
    """
    borders, others = (np.concatenate(parts) for parts in zip(*map(_border_and_rest, views), strict=True))
    if not len(borders):
        return None
    color = np.median(borders, axis=0)
    plain = (np.abs(borders - color) <= PLAIN).all(axis=1).mean() >= MOST
    if not plain or (np.abs(others - color) >= DIFFERENT).any(axis=1).mean() < SOME:
        return None
    red, green, blue = (color / 255).tolist()
    return red, green, blue


def without_backdrop(points: PointCloud, behind: Backdrop) -> PointCloud:
    """Return the points without those in the colour of a plain backdrop."""
    if not behind.plain:
        return points
    return points.rows((np.abs(points.colors - 255 * np.array(behind.color)) >= NEAR).any(axis=1))


def _border_and_rest(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels [P,3] float32 of a photograph's border, and its other pixels, without unknown ones."""
    step = -(-max(view.image.shape[:2]) // SIDE)
    image = view.image[::step, ::step].astype(np.float32)
    valid = np.ones(image.shape[:2], bool) if view.valid_mask is None else view.valid_mask[::step, ::step]
    width = max(1, round(BORDER * min(image.shape[:2])))
    border = np.ones(image.shape[:2], bool)
    border[width:-width, width:-width] = False
    return image[border & valid], image[~border & valid]
