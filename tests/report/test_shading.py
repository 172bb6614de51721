"""Shaded pictures, checked on a ball, whose outline, sides and distances are known."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.data.camera import Camera
from mgsr.data.up_direction import up_direction
from mgsr.report.pictures import depth_picture, normal_picture, ramp
from mgsr.report.shading import MeshPainter, PaintedMesh, side_camera, surface_pictures
from tests.report.samples import ball

UP, FRONT = np.array((0.0, 0.0, 1.0)), np.array((0.0, -3.0, 0.5))


def test_the_outline_is_the_balls() -> None:
    painter = MeshPainter(ball())
    camera = side_camera(ball().vertices, UP, FRONT, 0.0, 96)
    picture = painter.shaded(camera)
    tangent = 1 / np.sqrt(np.linalg.norm(camera.center) ** 2 - 1)
    disc = np.pi * (camera.K[0, 0] * tangent) ** 2
    assert abs(picture[..., 3].sum() / 255 / disc - 1) < 0.02
    assert picture[0, 0, 3] == 0 and picture[48, 48, 3] == 255


def test_light_comes_from_above() -> None:
    picture = MeshPainter(ball()).shaded(side_camera(ball().vertices, UP, FRONT, 0.0, 64)).astype(int)
    assert picture[18, 32, :3].sum() > picture[46, 32, :3].sum() + 60


@pytest.mark.slow
def test_what_is_hidden_is_dark_without_grain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that hidden parts of a ball on a plate are dark without grain.

    The measure is the same picture by thirty times as many rays, without smoothing.
    """
    corners = np.array([[-2, -2, -1.02], [2, -2, -1.02], [2, 2, -1.02], [-2, 2, -1.02]])
    vertices = np.concatenate([ball().vertices, corners])
    plate = len(ball().vertices) + np.array([[0, 1, 2], [0, 2, 3]])
    up = np.broadcast_to(UP, corners.shape)
    mesh = PaintedMesh(vertices, np.concatenate([ball().faces, plate]))
    painter = MeshPainter(mesh.with_normals(np.concatenate([ball().normals, up])))
    camera = side_camera(ball().vertices, UP, FRONT, 0.0, 96)
    quick = painter.shaded(camera).astype(float)
    monkeypatch.setattr("mgsr.report.shading.OCCLUSION_SPREAD", 0)
    grainy = painter.shaded(camera).astype(float)
    monkeypatch.setattr("mgsr.report.shading.OCCLUSION_RAYS", 400)
    wanted = painter.shaded(camera).astype(float)
    shown = wanted[..., 3] == 255
    error, before = (np.sqrt(((picture - wanted)[shown][:, :3] ** 2).mean()) for picture in (quick, grainy))
    assert error < 1.5 and error < before / 3, (error, before)


def test_the_first_side_faces_the_viewer_and_up_is_up() -> None:
    camera = side_camera(ball().vertices, UP, FRONT, 0.0, 64)
    # The ball of facets is not quite even, so its box's middle lies a little off the origin.
    assert camera.center[1] < -1 and abs(camera.center[0]) < 0.01
    pixels, depths = camera.project(np.array([[0, 0, 0], [0, 0, 0.5], [0.5, 0, 0]], float))
    assert (depths > 0).all() and np.allclose(pixels[0], 32, atol=0.1)
    assert pixels[1, 1] < pixels[0, 1] and pixels[2, 0] > pixels[0, 0]
    assert np.allclose(camera.cam_from_world[:3, :3] @ camera.cam_from_world[:3, :3].T, np.eye(3))


def test_distance_colours_follow_the_distance() -> None:
    """Check that a ball 1% too large lies everywhere in the middle of a scale that ends at 2%."""
    painter = MeshPainter(ball(1.01, 64))
    look = painter.look(side_camera(ball().vertices, UP, FRONT, 0.0, 48))
    lit = look.distances(ball(1.0, 64), 0.02)[24, 24, :3] / 255
    color = lit / lit.max()
    middle = ramp(np.array(0.5))
    assert np.abs(color - middle / middle.max()).max() < 0.12


def test_four_sides_of_each_kind_and_the_same_twice() -> None:
    mesh = ball()
    colored = PaintedMesh(mesh.vertices, mesh.faces, np.full_like(mesh.vertices, 0.4)).with_normals(mesh.normals)
    first, second = (surface_pictures(colored, UP, FRONT, mesh, size=24) for _ in range(2))
    for kind in ("shaded", "colored", "distance"):
        assert len(getattr(first, kind)) == 4
        for one, other in zip(getattr(first, kind), getattr(second, kind), strict=True):
            assert one.pixels.shape == (24, 24, 4) and np.array_equal(one.pixels, other.pixels)


def test_large_photographs_do_not_make_large_pictures() -> None:
    camera = side_camera(ball().vertices, UP, FRONT, 0.0, 64).resized(2400, 1200)
    assert MeshPainter(ball(rings=8)).shaded(camera).shape == (256, 512, 4)


def test_a_camera_that_sees_nothing_gets_an_empty_picture() -> None:
    behind = np.eye(4)
    behind[2, 3] = -5
    camera = Camera(np.array([[20.0, 0, 8], [0, 20, 8], [0, 0, 1]]), behind, 16, 16)
    assert MeshPainter(ball()).shaded(camera).max() == 0


def test_up_is_where_the_cameras_have_it() -> None:
    cameras = [side_camera(ball().vertices, UP, FRONT, angle, 8) for angle in (0.0, 90.0, 180.0, 270.0)]
    assert np.array_equal(up_direction(cameras), UP)


def test_normals_and_depths_as_pictures() -> None:
    camera = Camera(np.eye(3), np.eye(4), 2, 1)
    toward = np.array([[[0, 0, -1.0], [0, 0, 0]]])
    picture = normal_picture(toward, camera, np.array([[1.0, 0.0]]))
    assert picture[0, 0].tolist() == [128, 128, 255, 255] and picture[0, 1, 3] == 0
    assert depth_picture(np.zeros((2, 2)), np.ones((2, 2))).max() == 0
