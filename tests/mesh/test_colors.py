"""What views show of a surface, held to a ball, whose visible side is known."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.config.expert import ColorOptions
from mgsr.mesh import colors
from mgsr.mesh.colors import PointsInViews, blended_colors
from tests.mesh.shapes import ball, cameras_around, position_color, views_of

RADIUS, COUNT, GRAZING = 0.7, 5003, 0.3


def points_on_ball() -> np.ndarray:
    """Return directions [COUNT,3] that are spread over the sphere at random."""
    directions = np.random.default_rng(0).normal(size=(COUNT, 3))
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def in_views(normals: np.ndarray) -> PointsInViews:
    return PointsInViews(RADIUS * normals, normals, views_of(ball(RADIUS), cameras_around(6)), 0.5, 3.0, GRAZING)


def test_a_view_shows_the_side_of_a_ball_that_faces_it() -> None:
    normals = points_on_ball()
    points = in_views(normals)
    for number, view in enumerate(points.views):
        away = view.camera.center - RADIUS * normals
        cosines = (away * normals).sum(axis=1) / np.linalg.norm(away, axis=1)
        shown = points.shown_by(number)
        np.testing.assert_array_equal(shown.index, np.flatnonzero(cosines > GRAZING))
        np.testing.assert_allclose(shown.weights, cosines[shown.index] ** 2, rtol=1e-5)
        expected, _ = view.camera.project(RADIUS * normals[shown.index])
        np.testing.assert_allclose(shown.pixels, expected, atol=1e-3)


def test_a_part_of_the_points_is_shown_as_in_the_whole() -> None:
    points = in_views(points_on_ball())
    whole = points.shown_by(2)
    for first, end in ((0, 3), (8, 1999), (4000, COUNT)):
        part = points.shown_by(2, first, end)
        inside = (whole.index >= first) & (whole.index < end)
        np.testing.assert_array_equal(part.index, whole.index[inside])
        np.testing.assert_allclose(part.pixels, whole.pixels[inside], atol=1e-4)


@pytest.mark.parametrize("together", [8, 1 << 12, 1 << 19])
def test_colours_do_not_depend_on_the_number_blended_together(monkeypatch: pytest.MonkeyPatch, together: int) -> None:
    monkeypatch.setattr(colors, "_POINTS_AT_ONCE", together)
    normals = points_on_ball()[:200] if together == 8 else points_on_ball()
    blended, seen = blended_colors(in_views(normals), 1, ColorOptions())
    assert seen.mean() > 0.9
    assert np.abs(blended - position_color(RADIUS * normals))[seen].max() < 0.02
