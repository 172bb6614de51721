"""Photographs brought to a common exposure, against the formulas in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.data.exposure import at_common_exposure, brightness_jumps, raised_where_clipped, with_exposures
from mgsr.data.photograph import Photograph
from mgsr.data.scene import Exposures, View
from tests.training.ball import ball_scene


def to_linear(srgb: np.ndarray) -> np.ndarray:
    """Return linear light of sRGB values, float64 (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(light: np.ndarray) -> np.ndarray:
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def exposed(view: View, factor: np.ndarray) -> View:
    """Return the photograph that a camera takes of the same scene with this factor [3] of light."""
    light = np.clip(to_linear(view.image / 255) * factor, 0, 1)
    return replace(view, image=np.rint(255 * to_srgb(light)).astype(np.uint8))


@pytest.mark.parametrize("factor", [(0.5, 0.6, 0.7), (1.3, 1.0, 0.9)])
def test_what_an_exposure_did_is_undone(factor: tuple[float, float, float]) -> None:
    (view, *_) = ball_scene(size=40, train=4).train
    given = exposed(view, np.array(factor))
    back = at_common_exposure(given, np.array(factor))
    unclipped = (given.image < 255).all(-1)
    steep = 1 / min(1, *factor)  # darker photographs have fewer levels
    assert np.abs(back.image.astype(int) - view.image)[unclipped].max() <= np.ceil(steep)
    assert back.alpha is view.alpha and back.camera is view.camera


def test_a_factor_of_one_changes_no_pixel() -> None:
    scene = ball_scene(size=24, train=4)
    same = with_exposures(scene, Exposures(np.ones((len(scene.train), 3)), np.ones((len(scene.test), 3))))
    assert all(a.image is b.image for a, b in zip([*same.train, *same.test], [*scene.train, *scene.test], strict=True))


@pytest.mark.parametrize("factor", [(1.4, 1.8, 1.2), (0.7, 1.0, 0.8)])
def test_the_pixels_that_may_have_been_brighter_are_known(factor: tuple[float, float, float]) -> None:
    (plain, *_) = ball_scene(size=40, train=4).train
    view = replace(plain, image=np.random.default_rng(0).integers(20, 256, plain.image.shape, np.uint8))
    factors, true = np.array(factor), view.image / 255
    back = at_common_exposure(exposed(view, factors), factors)
    assert back.white is not None
    lost = np.clip(to_linear(true) * factors, 0, 1) >= to_linear(np.array(253 / 255))  # white in the photograph
    lost |= true >= 253 / 255  # or at the common exposure
    clipped = back.image >= back.white
    assert 0.005 < lost.mean() < 0.9
    assert clipped[lost].all()
    unlike = np.abs(back.image / 255 - true)
    assert unlike[~clipped].max() < 0.02
    raised = raised_where_clipped(back, true)
    assert np.abs(raised - true)[clipped].max() < 0.02, "the true light is no error"
    darker = raised_where_clipped(back, 0 * true)
    np.testing.assert_array_equal(darker, back.image / 255)
    assert not Photograph(replace(back, alpha=None)).usable[lost.any(axis=-1)].any()


def test_jumps_are_about_the_deviation_of_the_exposures() -> None:
    scene = ball_scene(size=24, train=40, test=2)
    assert brightness_jumps(scene.train) < 0.07
    noise = np.exp(np.random.default_rng(0).normal(-0.6, 0.2, len(scene.train)))
    views = [exposed(view, np.full(3, factor)) for view, factor in zip(scene.train, noise, strict=True)]
    assert 0.15 < brightness_jumps(views) < 0.26
