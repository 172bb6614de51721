"""Depth continued over what has no contrast."""

from __future__ import annotations

import numpy as np

from mgsr.start.depth_filling import fill_depth

HEIGHT, WIDTH = 48, 64


def plane(slope_x: float, slope_y: float, middle: float) -> np.ndarray:
    """Return inverse depths [h,w] of a plane before a pinhole camera: they change evenly over the image."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    depth: np.ndarray = middle + slope_x * (x - WIDTH / 2) + slope_y * (y - HEIGHT / 2)
    return depth


def on_lines(inverse: np.ndarray, every: int) -> np.ndarray:
    """Return what stereo's windows find where a floor's joints run: depth up to two pixels beside them."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    beside = (np.minimum(y % every, -y % every) <= 2) | (np.minimum(x % every, -x % every) <= 2)
    return np.where(beside, inverse, 0.0)


def test_a_floor_is_continued_between_its_joints() -> None:
    floor = plane(0.001, 0.004, 0.3)
    image = np.full((HEIGHT, WIDTH, 3), 180.0)
    image[::16], image[:, ::16] = 60.0, 60.0
    filled = fill_depth(on_lines(floor, 16), image)
    np.testing.assert_allclose(filled, floor, rtol=1e-3)


def test_what_is_known_stays() -> None:
    known = on_lines(plane(0.001, 0.004, 0.3) + np.random.default_rng(0).normal(0, 0.01, (HEIGHT, WIDTH)), 16)
    filled = fill_depth(known, np.full((HEIGHT, WIDTH, 3), 180.0))
    np.testing.assert_array_equal(filled[known > 0], known[known > 0])


def test_depth_breaks_where_the_image_does() -> None:
    near, far = plane(0.0, 0.002, 0.5), plane(0.0, 0.001, 0.2)
    left = np.arange(WIDTH) < WIDTH // 2
    image = np.where(left[None, :, None], 200.0, 40.0) * np.ones((HEIGHT, 1, 3))
    truth = np.where(left, near, far)
    filled = fill_depth(on_lines(truth, 16), image)
    np.testing.assert_allclose(filled, truth, rtol=5e-3)


def test_nothing_is_said_of_what_lies_beyond_an_edge_or_far_away() -> None:
    wall = plane(0.001, 0.0, 0.3)
    image = np.full((HEIGHT, WIDTH, 3), 180.0)
    image[10:30, 30:50] = 20.0  # in front of the wall, at a depth that nobody found
    known = np.where(np.arange(WIDTH) < 16, wall, 0.0)
    known[:, 20:28] = wall[:, 20:28]
    known[:9], known[31:] = wall[:9], wall[31:]
    filled = fill_depth(known, image)
    assert np.isnan(filled[11:29, 31:49]).all()
    np.testing.assert_allclose(filled[9:31, 16:20], wall[9:31, 16:20], rtol=1e-3)
    known[:, 8:] = 0
    assert np.isnan(fill_depth(known, np.full((HEIGHT, WIDTH, 3), 180.0))[:, 40:]).all()


def test_without_any_depth_there_is_nothing_to_continue() -> None:
    assert np.isnan(fill_depth(np.zeros((HEIGHT, WIDTH)), np.full((HEIGHT, WIDTH, 3), 180.0))).all()
