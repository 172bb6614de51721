"""The colour that lies behind everything: white, black, or that of a plain backdrop in the photographs.

Without masks, splats must show all that photographs show. Behind an object on black velvet or before white paper they
would so build a curtain, and the mesh would have it; as the colour behind the splats it costs none.
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
    """The colour behind the splats, sRGB 0..1. random: in training each iteration has another, and `color` is that on
    which renderings are judged. plain: photographs show it, so that what has this colour is taken for it."""

    color: Color
    random: bool = False
    plain: bool = False


def backdrop(scene: Scene, kind: Background) -> Backdrop:
    """What lies behind a scene's splats."""
    if kind is Background.RANDOM or (kind is Background.AUTO and scene.masked):
        return Backdrop(WHITE, random=True)
    if kind is Background.AUTO and scene.plain_backdrop is not None:
        return Backdrop(scene.plain_backdrop, plain=True)
    return Backdrop(BLACK if kind is Background.BLACK else WHITE)


def plain_backdrop(views: Sequence[View]) -> Color | None:
    """The one colour, sRGB 0..1, that the borders of photographs have where something else stands before it; None where
    they have no such colour. Looks at all of them: `Scene.plain_backdrop` keeps the answer."""
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
    """The points without those that have the colour of a plain backdrop."""
    if not behind.plain:
        return points
    return points.rows((np.abs(points.colors - 255 * np.array(behind.color)) >= NEAR).any(axis=1))


def _border_and_rest(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [P,3] of a photograph's border and others, of those that it shows."""
    step = -(-max(view.image.shape[:2]) // SIDE)
    image = view.image[::step, ::step].astype(np.float32)
    known = np.ones(image.shape[:2], bool) if view.known is None else view.known[::step, ::step]
    width = max(1, round(BORDER * min(image.shape[:2])))
    border = np.ones(image.shape[:2], bool)
    border[width:-width, width:-width] = False
    return image[border & known], image[~border & known]
