"""Exposures told by points of a surface: photographs exposed by known factors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mgsr.data.scene import Scene, View
from mgsr.start.point_exposures import exposure_gain, point_exposures
from tests.data.test_exposure import exposed
from tests.training.ball import RADIUS, ball_points, ball_scene

POINTS = ball_points(4000, RADIUS)


@cache
def even_ball(gloss: float) -> Scene:
    return ball_scene(96, train=20, test=4, gloss=gloss)


def exposed_ball(gloss: float = 0.0) -> tuple[list[View], list[View], np.ndarray]:
    """Return training and test views of a ball, each under a factor of its own, and the factors [V,3]."""
    scene = even_ball(gloss)
    draw = np.random.default_rng(2)
    factors = np.exp(draw.normal(-0.4, 0.3, (24, 1)) + draw.normal(0, 0.03, (24, 3)))
    factors[:20] /= np.exp(np.log(factors[:20]).mean(axis=0))
    views = [exposed(view, 0.7 * factor) for view, factor in zip([*scene.train, *scene.test], factors, strict=True)]
    return views[:20], views[20:], factors


@pytest.mark.parametrize(("normals", "off"), [(POINTS.normals, 0.02), (None, 0.03)])
def test_the_factors_of_a_matte_surface_are_found(normals: np.ndarray | None, off: float) -> None:
    """Check that factors are found with normals that tell which points are turned away, and with points alone.

    Points alone hide each other.
    """
    train, test, truth = exposed_ball()
    found = point_exposures(train, test, POINTS.positions, normals)
    assert found is not None
    np.testing.assert_allclose(found, truth, rtol=off)
    np.testing.assert_allclose(np.log(found[:20]).mean(axis=0), 0, atol=1e-9)


def test_a_highlight_that_follows_the_camera_counts_little() -> None:
    train, test, truth = exposed_ball(gloss=0.4)
    found = point_exposures(train, test, POINTS.positions, POINTS.normals)
    assert found is not None
    np.testing.assert_allclose(found, truth, rtol=0.06)


def test_test_views_do_not_change_the_factors_of_the_others() -> None:
    train, test, _ = exposed_ball()
    brighter = [exposed(view, np.full(3, 1.5)) for view in test]
    one, two = (point_exposures(train, each, POINTS.positions, POINTS.normals) for each in (test, brighter))
    assert one is not None and two is not None
    np.testing.assert_array_equal(one[:20], two[:20])


def test_too_few_points_tell_nothing() -> None:
    train, test, _ = exposed_ball()
    black = replace(train[0], image=np.zeros_like(train[0].image))
    assert point_exposures([black, *train[1:]], test, POINTS.positions, POINTS.normals) is None
    assert point_exposures(train, test, POINTS.positions[:30], None) is None


def test_the_gain_tells_whether_exposures_differ() -> None:
    """Check that the gain is large for varied exposures, and none for equal ones, with and without gloss."""
    for gloss in (0.0, 0.4):
        even = even_ball(gloss).train
        equal = exposure_gain(even, POINTS.positions, POINTS.normals)
        varied = exposure_gain(exposed_ball(gloss)[0], POINTS.positions, POINTS.normals)
        assert equal is not None and equal < 0.1
        assert varied is not None and varied > 6


def test_a_half_without_points_tells_no_gain() -> None:
    train, _, _ = exposed_ball()
    assert exposure_gain(train, POINTS.positions[:60], None) is None
