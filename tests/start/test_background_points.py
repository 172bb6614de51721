"""The surroundings of a capture: rooms whose walls are known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.start.background_points import background_points
from tests.training.ball import RADIUS, ball_points, ball_scene, surface_points

DISTANCE = 6.0  # of a round room's wall from the middle
BALL = ball_points(4000, RADIUS).positions


def wall_color(places: np.ndarray) -> np.ndarray:
    """Return a smooth pattern, waves of 2 to 3 units."""
    colors: np.ndarray = 0.5 + 0.35 * np.sin(places * [2.5, 3.0, 2.0] + [0.5, 1.5, 2.5])
    return colors


@cache
def room(pattern: bool = True) -> list[View]:
    """Return views of the ball from all around it, in a round room with a pattern or a plain wall."""
    cameras = [view.camera for view in ball_scene(64, 60).train]
    wide = [replace(camera, K=camera.K * [[0.5, 1, 1], [1, 0.5, 1], [1, 1, 1]]) for camera in cameras]
    return [View("v", camera, _picture(camera, pattern)) for camera in wide]


def _picture(camera: Camera, pattern: bool) -> np.ndarray:
    _, rays, ball = surface_points(camera)
    along = rays @ camera.center
    reach = -along + np.sqrt(along**2 - camera.center @ camera.center + DISTANCE**2)
    color = wall_color(camera.center + reach[..., None] * rays) if pattern else np.full((*ball.shape, 3), 0.6)
    return np.where(ball[..., None], 255 * 0.3, 255 * color).round().astype(np.uint8)


def test_a_wall_with_a_pattern_is_found() -> None:
    points = background_points(room(), BALL)
    distance = np.linalg.norm(points.positions, axis=1)
    assert len(points) > 1500
    assert 0.9 < np.median(distance) / DISTANCE < 1.1
    assert (np.abs(distance / DISTANCE - 1) < 0.25).mean() > 0.9
    assert np.abs(points.colors / 255 - wall_color(points.positions)).mean() < 0.06


@pytest.mark.slow
def test_a_plain_wall_has_its_colour_somewhere_behind_the_cameras_reach() -> None:
    points = background_points(room(pattern=False), BALL)
    assert len(points) > 1500 and np.linalg.norm(points.positions, axis=1).min() >= 1.5
    assert (np.abs(points.colors.astype(int) - 153) <= 3).mean() > 0.99  # a ball's edge here and there


@pytest.mark.parametrize("shown", ["none", "all"])
def test_nothing_is_added_where_all_is_found_or_nothing_is_known(shown: str) -> None:
    views = room()
    if shown == "none":
        views = [View("v", view.camera, view.image, valid_mask=np.zeros((64, 64), bool)) for view in views]
        found = BALL
    else:
        directions = ball_points(200_000, 1.0).positions
        found = np.concatenate([BALL, DISTANCE * directions])
    assert len(background_points(views, found)) == 0
