"""The step that ends a mesh at the plane on which a found object stands."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig
from mgsr.data.scene import Similarity
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.steps.cut_at_ground import CutAtGround
from mgsr.mesh.steps.step import StepContext
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photo_set import PhotoSet


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_nothing_is_left_below_the_ground(tilt: float) -> None:
    ball = trimesh.creation.icosphere(4)
    normal = np.array([np.sin(tilt), 0, np.cos(tilt)])
    context = StepContext([], PhotoSet([], [], 1), MeshConfig(), 0.02, None, lambda: True, np.append(normal, 0.5))
    mesh, light = Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)), LightEstimate()
    assert CutAtGround().applies(context, light)
    cut = CutAtGround().run(mesh, light, context).mesh
    heights = cut.vertices @ normal + 0.5
    edge = mesh.edge_length
    assert -0.02 - 1.5 * edge < heights.min() < 0
    # A cap of a unit ball with its base 0.5 from the centre has a quarter of the area.
    areas = np.linalg.norm(
        np.cross(*(cut.vertices[cut.faces[:, i]] - cut.vertices[cut.faces[:, 0]] for i in (1, 2))), axis=1
    )
    assert areas.sum() / 2 == pytest.approx(0.75 * 4 * np.pi, rel=0.05)


def test_a_plane_holds_the_same_points_in_the_users_frame() -> None:
    random = np.random.default_rng(0)
    frame = Similarity(2.5, np.array([3.0, -1.0, 0.5]))
    points = random.normal(size=(20, 3)) * [1, 1, 0] + [0, 0, -0.8]
    plane = frame.plane_to_user(np.array([0, 0, 1, 0.8]))
    np.testing.assert_allclose(frame.to_user(points) @ plane[:3] + plane[3], 0, atol=1e-12)
    np.testing.assert_allclose(frame.inverse.plane_to_user(plane), [0, 0, 1, 0.8], atol=1e-12)
