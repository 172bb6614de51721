"""Sheets of small pictures."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.report.contact_sheet import TILE, columns, contact_sheet

COLORS = [(200, 10, 10), (10, 200, 10), (10, 10, 200), (90, 90, 90), (250, 250, 10)]


def plain(color: tuple[int, int, int], height: int, width: int) -> np.ndarray:
    return np.full((height, width, 3), color, np.uint8)


def test_pictures_lie_in_their_order_with_their_shape() -> None:
    wide, high = plain(COLORS[0], 300, 400), plain(COLORS[1], 400, 200)
    sheet = contact_sheet([wide, high, None, plain(COLORS[3], 50, 50), plain(COLORS[4], 128, 128)], 5)
    assert columns(5) == 3 and sheet.shape == (2 * TILE, 3 * TILE, 4)
    tiles = [sheet[y : y + TILE, x : x + TILE] for y in (0, TILE) for x in (0, TILE, 2 * TILE)]
    shown = [np.argwhere(tile[..., 3] == 255) for tile in tiles]
    sizes = [tuple(np.ptp(places, axis=0) + 1) if len(places) else (0, 0) for places in shown]
    assert sizes == [(96, 128), (128, 64), (0, 0), (50, 50), (128, 128), (0, 0)]
    middles = [places.mean(axis=0).tolist() for places in shown if len(places)]
    assert middles == [[63.5, 63.5]] * 4
    for index in (0, 1, 3, 4):
        assert (tiles[index][64, 64, :3] == COLORS[index]).all()


@pytest.mark.parametrize("count", [1, 2, 4, 56, 300])
def test_a_sheet_is_nearly_square(count: int) -> None:
    height, width, _ = contact_sheet([None] * count, count).shape
    assert height // TILE * (width // TILE) >= count and width - height <= TILE
