"""The backdrop's colour, found from the photographs' borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.config import Background
from mgsr.config.expert import BackdropOptions, DataOptions
from mgsr.data.backdrop import BLACK, WHITE, Backdrop
from tests.training.ball import before

GREY = (90, 120, 60)


@pytest.mark.parametrize("color", [(0, 0, 0), (255, 255, 255), GREY])
def test_a_plain_backdrop_is_found(color: tuple[int, int, int]) -> None:
    scene = before(color)
    found = scene.backdrop(Background.AUTO)
    assert not found.random and found.color == pytest.approx([value / 255 for value in color], abs=3 / 255)


def test_no_backdrop_where_the_borders_differ_or_nothing_stands_before_it() -> None:
    scene = before(GREY, noise=20)
    assert scene.plain_backdrop is None and scene.backdrop(Background.AUTO) == Backdrop(scene.mean_color)
    half = before(GREY)
    for view in half.train:
        view.image[: view.image.shape[0] // 3] = 255
    assert half.plain_backdrop is None
    empty = [replace(view, image=np.full_like(view.image, 40)) for view in scene.train]
    assert replace(scene, train=empty).plain_backdrop is None


def test_the_mean_colour_is_that_of_valid_pixels() -> None:
    scene = before(GREY, noise=20)
    mean = np.mean([view.image.astype(float).mean(axis=(0, 1)) for view in scene.train], axis=0) / 255
    assert scene.mean_color == pytest.approx(mean, abs=0.02)
    upper = np.zeros(scene.train[0].image.shape[:2], bool)
    upper[: len(upper) // 2] = True
    for view in scene.train:
        view.image[:] = np.where(upper[..., None], np.array(GREY, np.uint8), 255)
    half = [replace(view, valid_mask=upper) for view in scene.train]
    assert replace(scene, train=half).mean_color == pytest.approx([value / 255 for value in GREY])
    nothing = [replace(view, valid_mask=np.zeros_like(upper)) for view in scene.train]
    assert replace(scene, train=nothing).mean_color == WHITE


def test_the_scenes_options_decide() -> None:
    scene = before(GREY, noise=20)
    tolerant = DataOptions(backdrop=BackdropOptions(plain=70, different=71, near=70))
    found = replace(scene, options=tolerant).backdrop(Background.AUTO)
    assert found.plain and found.near == 70
    colors = np.array([GREY, (GREY[0] + 60, *GREY[1:])], np.uint8)
    assert found.hides(colors).all() and not before(GREY).backdrop(Background.AUTO).hides(colors[1:]).any()


def test_unknown_pixels_are_no_border() -> None:
    scene = before(GREY)
    width = scene.train[0].image.shape[1] // 8
    views = []
    for view in scene.train:
        known = np.ones(view.image.shape[:2], bool)
        known[:, :width] = False
        view.image[:, :width] = 0
        views.append(replace(view, valid_mask=known))
    assert replace(scene, train=views).plain_backdrop == pytest.approx([value / 255 for value in GREY], abs=3 / 255)
    unknown = [replace(view, valid_mask=np.zeros_like(view.valid_mask)) for view in views]
    assert replace(scene, train=unknown).plain_backdrop is None


def test_settings_and_masks_go_before() -> None:
    assert before(GREY, masked=True).backdrop(Background.AUTO) == Backdrop(WHITE, random=True)
    scene = before(GREY)
    assert scene.backdrop(Background.RANDOM).random
    assert scene.backdrop(Background.BLACK) == Backdrop(BLACK)
    assert scene.backdrop(Background.WHITE) == Backdrop(WHITE)


def test_nothing_starts_in_the_backdrops_colour() -> None:
    colors = np.array([GREY, (95, 110, 70), (200, 120, 60), (0, 0, 0)], np.uint8)
    behind = before(GREY).backdrop(Background.AUTO)
    assert behind.plain and behind.hides(colors).tolist() == [True, True, False, False]
    assert not replace(behind, plain=False).hides(colors).any()
