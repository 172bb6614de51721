"""Scores of runs whose masks were put aside."""

import numpy as np

from mgsr.cli.evaluation import off_white


def test_off_white_gives_back_the_straight_colours():
    generator = np.random.default_rng(0)
    straight = generator.integers(0, 256, (32, 32, 3)) / 255
    alpha = generator.integers(128, 256, (32, 32)).astype(np.uint8)
    cover = alpha[..., None] / 255
    on_white = np.round(255 * (straight * cover + 1 - cover)).astype(np.uint8)
    # Half a step of the composite is at most a whole one of the colour, where the cover is over a half.
    assert np.abs(off_white(on_white, alpha) - straight).max() <= 1.0 / 255


def test_off_white_stays_finite_where_nothing_is_covered():
    nothing = off_white(np.full((4, 4, 3), 255, np.uint8), np.zeros((4, 4), np.uint8))
    assert np.isfinite(nothing).all()
