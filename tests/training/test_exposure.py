"""Exposures that are found: photographs exposed by known factors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.config import make_config
from mgsr.config.expert import ExposureOptions
from mgsr.data.exposure import brightness_jumps, with_exposures
from mgsr.data.scene import Exposures, Scene
from mgsr.errors import Cancelled
from mgsr.training import exposure
from mgsr.training.exposure import find_exposures
from tests.data.test_exposure import exposed
from tests.training.ball import ball_points, ball_scene

START = ball_points(1500)


def varied(scene: Scene, deviation: float = 0.3) -> tuple[Scene, np.ndarray]:
    """Vary each photograph's exposure, and slightly its white balance; return the scene and the factors [V,3].

    The factors are of the training views, then of the test views.
    """
    draw = np.random.default_rng(5)
    views = [*scene.train, *scene.test]
    factors = np.exp(draw.normal(-0.3, deviation, (len(views), 1)) + draw.normal(0, 0.1 * deviation, (len(views), 3)))
    given = [exposed(view, factor) for view, factor in zip(views, factors, strict=True)]
    count = len(scene.train)
    return replace(scene, train=given[:count], test=given[count:]), factors


@pytest.mark.parametrize("masked", [True, False])
def test_the_factors_are_found(masked: bool) -> None:
    even = ball_scene(size=40, train=40, test=4, masked=masked)
    scene, truth = varied(even)
    found = find_exposures(scene, START, seed=0)
    assert found is not None
    factors = np.concatenate([found.train, found.test])
    np.testing.assert_allclose(np.exp(np.log(factors[:40]).mean(axis=0)), 1, atol=1e-5)
    # The photographs differ by 0.3. What changes slowly with the direction could be light, and may stay.
    error = np.log(factors / truth).mean(axis=1)
    error -= error[:40].mean()
    assert error[:40].std() < (0.1 if masked else 0.2) and np.abs(error[40:]).max() < 0.25
    jumps = [brightness_jumps(each.train) for each in (even, with_exposures(scene, found), scene)]
    assert jumps[2] > 0.25 and jumps[1] < jumps[0] + 0.06


@pytest.mark.slow
def test_light_that_moves_with_the_camera_is_no_exposure() -> None:
    expert = make_config(overrides=["exposure.min_jump=0"]).expert
    for gloss in (0.0, 0.6):
        assert find_exposures(ball_scene(size=40, train=24, test=4, gloss=gloss), START, seed=0, expert=expert) is None


def test_nothing_is_trained_for_even_photographs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exposure, "_trained", None)
    assert find_exposures(ball_scene(size=24, train=40), START, seed=0) is None
    few, _ = varied(ball_scene(size=24, train=6))
    assert find_exposures(few, START, seed=0) is None


@pytest.mark.slow
def test_the_same_seed_gives_the_same_factors() -> None:
    scene, _ = varied(ball_scene(size=32, train=16, test=2))
    first, again = (find_exposures(scene, START, seed=1) for _ in range(2))
    assert first is not None and again is not None
    assert (first.train == again.train).all() and (first.test == again.test).all()


def test_a_wish_to_stop_is_heeded() -> None:
    scene, _ = varied(ball_scene(size=32, train=16, test=2))
    with pytest.raises(Cancelled, match="stopped on request in exposures after 0 iterations"):
        find_exposures(scene, START, seed=0, should_stop=lambda: True)


def test_the_difference_between_the_brightest_and_the_darkest() -> None:
    exposures = Exposures(np.array([[0.5, 0.5, 0.5], [1.0, 2.0, 0.5]]), np.array([[2.0, 2.0, 2.0]]))
    assert exposures.largest_difference == pytest.approx(4)


def test_a_slow_drift_in_a_video_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that exposures are compared where frames differ less from the next ones than photographs do."""
    ring = [view for view in ball_scene(size=12, train=1500).train if abs(view.camera.center[2]) < 0.4]
    frames = sorted(ring, key=lambda view: np.arctan2(view.camera.center[1], view.camera.center[0]))
    drift = np.random.default_rng(3).normal(0, 0.05, len(frames)).cumsum()
    video = [exposed(view, np.full(3, np.exp(step - drift.max()))) for view, step in zip(frames, drift, strict=True)]
    assert len(video) > 200 and brightness_jumps(video) < ExposureOptions().min_jump

    def compared(*_: object) -> np.ndarray:
        raise Cancelled

    monkeypatch.setattr(exposure, "_kept_errors", compared)
    with pytest.raises(Cancelled):
        find_exposures(replace(ball_scene(size=12), train=video), START, seed=0)
    assert find_exposures(replace(ball_scene(size=12), train=frames), START, seed=0) is None
