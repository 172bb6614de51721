"""Ray casting of meshes far from their frame's origin, against the same meshes at it, and near it against Open3D."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.data.camera import Camera
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.precision import middle_for_float
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.open3d_library import load_open3d
from tests.mesh.shapes import ball, looking_at_origin
from tests.optional import present

AWAYS = [np.array([512345.67, 4501234.4, 431.2]), np.array([4308323.455338789, -628516.4200458565, 4645883.308119935])]
BALL = ball()
PLACE = np.array([1.0, 2.0, 2.0])


def moved(camera: Camera, away: np.ndarray) -> Camera:
    pose = camera.cam_from_world.copy()
    pose[:3, 3] -= pose[:3, :3] @ away
    return Camera(camera.K, pose, camera.width, camera.height)


def near_and_far(away: np.ndarray) -> tuple[RayCaster, RayCaster]:
    return RayCaster(BALL.vertices, BALL.faces), RayCaster(BALL.vertices + away, BALL.faces)


@pytest.mark.parametrize("away", [np.zeros(3), np.array([20.0, -30.0, 5.0])], ids=["at the origin", "beside it"])
def test_near_the_origin_the_hits_are_open3ds_to_the_bit(away: np.ndarray) -> None:
    camera = moved(looking_at_origin(PLACE), away)
    open3d = load_open3d()
    scene = open3d.t.geometry.RaycastingScene()
    vertices, faces = (BALL.vertices + away).astype(np.float32), BALL.faces.astype(np.uint32)
    scene.add_triangles(open3d.core.Tensor(vertices), open3d.core.Tensor(faces))
    rays = pixel_rays(camera)
    starts = np.broadcast_to(camera.center.astype(np.float32), rays.shape)
    target = scene.cast_rays(open3d.core.Tensor(np.concatenate([starts, rays], axis=-1)))
    hits = RayCaster(BALL.vertices + away, BALL.faces).cast(camera)
    np.testing.assert_array_equal(hits.face, target["primitive_ids"].numpy())
    np.testing.assert_array_equal(hits.depth[hits.mask], target["t_hit"].numpy()[hits.mask])


@pytest.mark.parametrize("away", AWAYS, ids=["utm", "geocentric"])
def test_far_away_a_camera_sees_what_it_sees_at_the_origin(away: np.ndarray) -> None:
    camera = looking_at_origin(PLACE)
    near, far = near_and_far(away)
    here, there = near.cast(camera), far.cast(moved(camera, away))
    assert here.mask.sum() > 1000
    assert (here.mask != there.mask).sum() <= 2
    both = here.mask & there.mask
    np.testing.assert_allclose(there.depth[both], here.depth[both], rtol=0, atol=2e-5)
    same = both & (here.face == there.face)
    assert same.sum() > 0.995 * both.sum()
    np.testing.assert_allclose(there.normal[same], here.normal[same], rtol=0, atol=1e-4)
    pixels = np.random.default_rng(0).uniform(30, 60, (200, 2))
    one, other = near.cast_pixels(camera, pixels), far.cast_pixels(moved(camera, away), pixels)
    np.testing.assert_allclose(other.depth, one.depth, rtol=0, atol=2e-5)


@pytest.mark.parametrize("away", AWAYS, ids=["utm", "geocentric"])
def test_far_away_the_same_points_are_seen_and_nearest(away: np.ndarray) -> None:
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points *= 0.7 / np.linalg.norm(points, axis=1, keepdims=True)
    near, far = near_and_far(away)
    camera = looking_at_origin(PLACE)
    seen = near.sees(camera, points, gap=0.01)
    assert 200 < seen.sum() < 1800
    assert (far.sees(moved(camera, away), points + away, gap=0.01) != seen).sum() <= 2
    assert (far.reached(PLACE + away, points + away, 0.01) != near.reached(PLACE, points, 0.01)).sum() <= 2
    # A field that is linear in the place comes back as the point's foot on the mesh, 4e-4 at most below the sphere.
    feet = Mesh(BALL.vertices + away, BALL.faces).prolongation(points + away) @ BALL.vertices
    np.testing.assert_allclose(feet, points, rtol=0, atol=1e-3)


def test_positions_are_taken_about_a_middle_only_where_float32_is_too_coarse() -> None:
    corners = np.array([[-1.0, -1, -1], [1, 2, 3]])
    assert middle_for_float(corners) is None
    assert middle_for_float(corners + 300) is None
    np.testing.assert_allclose(present(middle_for_float(corners + AWAYS[0])), AWAYS[0] + [0, 0.5, 1])
    assert middle_for_float(np.zeros((0, 3))) is None
