"""Tests of ambient occlusion and interreflection in a bowl, against the view factors of a sphere, which are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mgsr.data.camera import Camera
from mgsr.data.photograph import Photograph
from mgsr.geometry.mesh import Mesh
from mgsr.shading.ambient_occlusion import estimate_occlusion
from tests.shading.painted import as_photograph

SIDE = 96


def bowl(height: float) -> tuple[np.ndarray, np.ndarray]:
    """Build a ball's inside below a height, of radius 1, with its faces turned inwards."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    kept = ball.faces[ball.triangles_center[:, 2] < height][:, ::-1]
    used, faces = np.unique(kept, return_inverse=True)
    return np.asarray(ball.vertices)[used], faces.reshape(-1, 3)


def from_above(brightness: float) -> Photograph:
    """Return a photograph in which all that a camera above a bowl sees is equally bright."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0, 0, 6]
    K = np.array([[150.0, 0, SIDE / 2], [0, 150.0, SIDE / 2], [0, 0, 1]])
    return as_photograph(Camera(K, pose, SIDE, SIDE), np.full((SIDE, SIDE), brightness))


@pytest.mark.parametrize("height", [0.0, -0.5])
def test_each_point_of_a_ball_sees_its_parts_by_their_area(height: float) -> None:
    vertices, faces = bowl(height)
    occlusion = estimate_occlusion(Mesh(vertices, faces), [from_above(0.4), from_above(0.2)], gap=0.002)
    deep = np.flatnonzero(vertices[:, 2] < height - 0.1)
    share = trimesh.Trimesh(vertices, faces).area / (4 * np.pi)  # of the ball's area, which the bowl is
    assert np.abs(occlusion.sky_visibility[deep] - (1 - share)).mean() < 0.03
    assert abs(occlusion.sky_visibility[deep].mean() - (1 - share)) < 0.005
    # Only the rim is too grazing to be read from above.
    np.testing.assert_allclose(occlusion.interreflection[deep].mean(axis=0), [0.4 * share, 0.2 * share], rtol=0.1)


def test_a_ball_hides_and_throws_nothing() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    occlusion = estimate_occlusion(Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)), [from_above(1.0)], gap=0.02)
    assert (occlusion.sky_visibility == 1).all() and not occlusion.interreflection.any()


def test_points_between_vertices_get_what_lies_between() -> None:
    vertices, faces = bowl(0.0)
    occlusion = estimate_occlusion(Mesh(vertices, faces), [from_above(0.4), from_above(0.2)], gap=0.02)
    corners, shares = faces[100], np.array([0.5, 0.3, 0.2])
    point = (shares @ vertices[corners])[None] + 0.001 * Mesh(vertices, faces).normals[corners[:1]]
    sky_visibility, interreflection = occlusion.at(point, np.array([[1, 0]]))
    np.testing.assert_allclose(sky_visibility, shares @ occlusion.sky_visibility[corners], atol=0.01)
    np.testing.assert_allclose(interreflection, [shares @ occlusion.interreflection[corners][:, ::-1]], atol=0.01)
