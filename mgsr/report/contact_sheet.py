"""Contact sheets: small photographs in one picture, so that a page loads all of them at once."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from mgsr.report.encode import shrunk

TILE = 128  # pixels; side of the square that holds one photograph


def columns(count: int) -> int:
    """Return the number of tiles in a row of a sheet of `count` photographs."""
    return max(1, math.ceil(math.sqrt(count)))


def contact_sheet(pictures: Iterable[np.ndarray | None], count: int) -> np.ndarray:
    """Return a sheet uint8 [H,W,4] of `count` pictures uint8 [h,w,3], row by row.

    Each picture is reduced to fit, and centred in its tile. The rest of the tile is transparent. None leaves a tile
    empty.
    """
    across = columns(count)
    sheet = np.zeros((math.ceil(count / across) * TILE, across * TILE, 4), np.uint8)
    for index, picture in enumerate(pictures):
        if picture is None:
            continue
        small = shrunk(picture, TILE)
        height, width = small.shape[:2]
        top = index // across * TILE + (TILE - height) // 2
        left = index % across * TILE + (TILE - width) // 2
        sheet[top : top + height, left : left + width, :3] = small
        sheet[top : top + height, left : left + width, 3] = 255
    return sheet
