"""The colour behind everything: white, black, or the colour of a plain backdrop in the photographs.

Without masks, splats must reproduce everything that photographs show. Around an object on black velvet or before white
paper they would build a curtain, which would end up in the mesh. With the backdrop's colour behind the splats, none are
needed there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)
BLACK: Color = (0.0, 0.0, 0.0)

SIDE = 200  # pixels a side; larger photographs are subsampled by rows and columns
BORDER = 0.03  # border width, as a share of a photograph's shorter side
PLAIN, MOST = 16, 0.9  # a plain backdrop has this share of border pixels this near (of 255) to their median
DIFFERENT, SOME = 48, 0.02  # and this share of other pixels this far from it; else nothing stands before it
NEAR = 24  # colours nearer (of 255) to the backdrop's colour count as backdrop


@dataclass(frozen=True)
class Backdrop:
    """The colour behind the splats, sRGB 0..1.

    random: training draws another colour in each iteration; evaluation uses `color`.
    plain: the photographs show this backdrop, so pixels of its colour count as backdrop.
    """

    color: Color
    random: bool = False
    plain: bool = False

    def hides(self, colors: np.ndarray) -> np.ndarray:
        """Return [P] bool: which colours [P,3] uint8 sRGB are taken for a plain backdrop; none without one."""
        if not self.plain:
            return np.zeros(len(colors), bool)
        hidden: np.ndarray = (np.abs(colors - 255 * np.array(self.color)) < NEAR).all(axis=1)
        return hidden


def plain_backdrop(photographs: Sequence[tuple[np.ndarray, np.ndarray | None]]) -> Color | None:
    """Find the colour, sRGB 0..1, that nearly all borders of the photographs share.

    photographs: each an image [H,W,3] uint8 sRGB, and the pixels [H,W] bool that it shows, None where it shows all.
    Returns None where the borders share no colour, or where nothing stands before the backdrop. It reads all
    photographs; `Scene.plain_backdrop` caches the result.
    """
    borders, others = (
        np.concatenate(parts)
        for parts in zip(*(_border_and_rest(*photograph) for photograph in photographs), strict=True)
    )
    if not len(borders):
        return None
    color = np.median(borders, axis=0)
    plain = (np.abs(borders - color) <= PLAIN).all(axis=1).mean() >= MOST
    if not plain or (np.abs(others - color) >= DIFFERENT).any(axis=1).mean() < SOME:
        return None
    red, green, blue = (color / 255).tolist()
    return red, green, blue


def _border_and_rest(pixels: np.ndarray, valid_mask: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels [P,3] float32 of a photograph's border, and its other pixels, without unknown ones."""
    step = -(-max(pixels.shape[:2]) // SIDE)
    image = pixels[::step, ::step].astype(np.float32)
    valid = np.ones(image.shape[:2], bool) if valid_mask is None else valid_mask[::step, ::step]
    width = max(1, round(BORDER * min(image.shape[:2])))
    border = np.ones(image.shape[:2], bool)
    border[width:-width, width:-width] = False
    return image[border & valid], image[~border & valid]
