"""The backdrop's colour, found from the photographs' borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.config import Background
from mgsr.data.backdrop import BLACK, WHITE, Backdrop, backdrop, plain_backdrop, without_backdrop
from mgsr.data.scene import PointCloud
from tests.training.ball import before

GREY = (90, 120, 60)


@pytest.mark.parametrize("color", [(0, 0, 0), (255, 255, 255), GREY])
def test_a_plain_backdrop_is_found(color: tuple[int, int, int]) -> None:
    scene = before(color)
    found = backdrop(scene, Background.AUTO)
    assert not found.random and found.color == pytest.approx([value / 255 for value in color], abs=3 / 255)


def test_no_backdrop_where_the_borders_differ_or_nothing_stands_before_it() -> None:
    scene = before(GREY, noise=20)
    assert plain_backdrop(scene.train) is None and backdrop(scene, Background.AUTO) == Backdrop(WHITE)
    half = before(GREY)
    for view in half.train:
        view.image[: view.image.shape[0] // 3] = 255
    assert plain_backdrop(half.train) is None
    empty = [replace(view, image=np.full_like(view.image, 40)) for view in scene.train]
    assert plain_backdrop(empty) is None


def test_unknown_pixels_are_no_border() -> None:
    scene = before(GREY)
    width = scene.train[0].image.shape[1] // 8
    views = []
    for view in scene.train:
        known = np.ones(view.image.shape[:2], bool)
        known[:, :width] = False
        view.image[:, :width] = 0
        views.append(replace(view, valid_mask=known))
    assert plain_backdrop(views) == pytest.approx([value / 255 for value in GREY], abs=3 / 255)
    assert plain_backdrop([replace(view, valid_mask=np.zeros_like(view.valid_mask)) for view in views]) is None


def test_settings_and_masks_go_before() -> None:
    assert backdrop(before(GREY, masked=True), Background.AUTO) == Backdrop(WHITE, random=True)
    scene = before(GREY)
    assert backdrop(scene, Background.RANDOM).random
    assert backdrop(scene, Background.BLACK) == Backdrop(BLACK)
    assert backdrop(scene, Background.WHITE) == Backdrop(WHITE)


def test_nothing_starts_in_the_backdrops_colour() -> None:
    colors = np.array([GREY, (95, 110, 70), (200, 120, 60), (0, 0, 0)], np.uint8)
    points = PointCloud(np.arange(12.0).reshape(4, 3), colors)
    behind = backdrop(before(GREY), Background.AUTO)
    assert behind.plain and without_backdrop(points, behind).positions[:, 0].tolist() == [6.0, 9.0]
    assert len(without_backdrop(points, replace(behind, plain=False))) == 4
