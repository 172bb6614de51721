"""Tests of what two surfaces leave unexplained of photographs: of a ball that mirrors a room, and of a painted one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mgsr.data.scene import View
from mgsr.geometry.mesh import Mesh
from mgsr.shading.environment_residual import environment_residuals
from mgsr.shading.photo_set import PhotoSet
from tests.mesh.shapes import as_mesh, ball
from tests.shading.balls import RADIUS, VIEWS, mirror_photographs, painted_photographs

TAKEN = [mirror_photographs, painted_photographs]


@pytest.mark.parametrize("photographs", TAKEN)
def test_where_a_surface_is_right_it_leaves_least(photographs: Callable[[int], list[View]]) -> None:
    """Check that a surface leaves least unexplained where it is right.

    Half of a ball is pressed flat; each camera compares the two surfaces where it sees them.
    """
    views, right = photographs(96), ball(RADIUS)
    pressed = right.vertices.copy()
    pressed[:, 2] = np.minimum(pressed[:, 2], 0.5 * RADIUS)
    on_ball, on_pressed = environment_residuals([as_mesh(right), Mesh(pressed, right.faces)], PhotoSet(views))
    assert on_ball.ratio < on_pressed.ratio
    worse: list[np.ndarray] = []
    alike: list[np.ndarray] = []
    for view in views:
        before, after = on_ball.seen_by(view.camera), on_pressed.seen_by(view.camera)
        reported = (before > 0) & (after > 0)
        hits = view.camera.center[2] > 2 and reported.sum() > 200
        (worse if hits else alike).extend(np.log2(after[reported] / before[reported]) / 2)
    assert np.median(worse) > 1, "from above, the cameras see what is pressed"
    assert abs(np.median(alike)) < 0.3


def test_what_is_not_seen_is_not_told() -> None:
    views, right = painted_photographs(96), ball(RADIUS)
    (found,) = environment_residuals([as_mesh(right)], PhotoSet(views[:2]))
    assert len(views) == VIEWS and not found.variance.any(), "two readings tell nothing of a point"
    (found,) = environment_residuals([as_mesh(right)], PhotoSet(views))
    seen = found.seen_by(views[0].camera)
    # The mesh that is compared has coarser faces than the ball, whose outline they cut by a little.
    outside, inside = (views[0].alpha == value for value in (0, 255))
    assert (seen[outside] > 0).mean() < 0.005 and (seen[inside] > 0).mean() > 0.9
