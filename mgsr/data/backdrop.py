"""The colour behind everything: white, black, or the colour of a plain backdrop in the photographs.

Without masks, splats must reproduce everything that photographs show. Around an object on black velvet or before white
paper they would form a curtain, which would become part of the mesh. With the backdrop's colour behind the splats, no
splats are needed there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import BackdropOptions

Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)
BLACK: Color = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Backdrop:
    """The colour behind the splats, sRGB 0..1.

    random: training draws another colour in each iteration; evaluation uses `color`.
    plain: the photographs show this backdrop, so points of its colour count as backdrop.
    near: the largest difference, of 255, from the backdrop's colour at which a point counts as backdrop.
    """

    color: Color
    random: bool = False
    plain: bool = False
    near: int = BackdropOptions().near

    def hides(self, colors: np.ndarray) -> np.ndarray:
        """Return which colors [P,3] uint8 sRGB count as the plain backdrop, [P] bool; all False without one."""
        if not self.plain:
            return np.zeros(len(colors), bool)
        hidden: np.ndarray = (np.abs(colors - 255 * np.array(self.color)) < self.near).all(axis=1)
        return hidden


def plain_backdrop(
    photographs: Sequence[tuple[np.ndarray, np.ndarray | None]], options: BackdropOptions = BackdropOptions()
) -> Color | None:
    """Find the colour, sRGB 0..1, that nearly all borders of the photographs share.

    photographs: images [H,W,3] uint8 sRGB, each with its valid pixels [H,W] bool, None for all. Returns None if the
    borders share no colour, or if nothing stands before the backdrop. The function reads all photographs;
    `Scene.plain_backdrop` caches the result.
    """
    borders, others = (
        np.concatenate(parts)
        for parts in zip(*(_border_and_rest(*photograph, options) for photograph in photographs), strict=True)
    )
    if not len(borders):
        return None
    color = np.median(borders, axis=0)
    plain = (np.abs(borders - color) <= options.plain).all(axis=1).mean() >= options.min_plain
    if not plain or (np.abs(others - color) >= options.different).any(axis=1).mean() < options.min_different:
        return None
    red, green, blue = (color / 255).tolist()
    return red, green, blue


def _border_and_rest(
    pixels: np.ndarray, valid_mask: np.ndarray | None, options: BackdropOptions
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels [P,3] float32 of a photograph's border, and its other pixels, without unknown ones."""
    step = -(-max(pixels.shape[:2]) // options.side)
    image = pixels[::step, ::step].astype(np.float32)
    valid = np.ones(image.shape[:2], bool) if valid_mask is None else valid_mask[::step, ::step]
    width = max(1, round(options.border * min(image.shape[:2])))
    border = np.ones(image.shape[:2], bool)
    border[width:-width, width:-width] = False
    return image[border & valid], image[~border & valid]
