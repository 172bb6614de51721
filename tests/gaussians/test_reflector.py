"""Tests of what cameras see of a reflecting surface, against a ball and a corner of two mirrors worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from mgsr.data.camera import Camera
from mgsr.gaussians import reflector as reflector_module
from mgsr.gaussians.reflector import Reflector
from mgsr.geometry.mesh import Mesh

CPU = torch.device("cpu")
SIZE = 2.0  # of the corner's mirrors


def ball() -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    return Mesh(np.asarray(sphere.vertices), np.asarray(sphere.faces))


def corner() -> Mesh:
    """Build two square mirrors at a right angle: on z = 0 facing +z, and on x = 0 facing +x.

    They meet at the y axis.
    """
    floor = np.array([[0, -1, 0], [SIZE, -1, 0], [SIZE, 1, 0], [0, 1, 0.0]])
    wall = np.array([[0, -1, 0], [0, 1, 0], [0, 1, SIZE], [0, -1, SIZE]])
    return Mesh(np.concatenate([floor, wall]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))


def camera_at(place: list[float], target: list[float], focal: float = 30.0) -> Camera:
    ahead = np.subtract(target, place) / np.linalg.norm(np.subtract(target, place))
    right = np.cross(ahead, [0.0, 1.0, 0.1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(ahead, right), ahead]
    pose[:3, 3] = -pose[:3, :3] @ place
    return Camera(np.array([[focal, 0, 16], [0, focal, 12], [0, 0, 1.0]]), pose, 32, 24)


def corner_camera() -> Camera:
    return camera_at([2.0, 0.3, 2.4], [0.6, 0.0, 0.5])


def sights(camera: Camera) -> np.ndarray:
    """Return unit world directions [H,W,3] in which the pixels' centres look."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.cam_from_world[:3, :3]
    directions: np.ndarray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return directions


def test_a_ball_has_its_normals_and_mirrors_nothing_of_itself() -> None:
    camera = camera_at([1.0, 0.5, 2.0], [0.0, 0.0, 0.0], focal=40.0)
    seen = Reflector(ball()).seen_by(camera, CPU)
    rays, middle = sights(camera), camera.center
    along = (rays * middle).sum(axis=-1)
    root = along**2 - middle @ middle + 0.25
    met = root > 0.02  # but for the rim, where the facets show
    places = middle + rays * (-along - np.sqrt(np.maximum(root, 0)))[..., None]
    away = np.linalg.norm(seen.normals.numpy() - places / 0.5, axis=-1)[met]
    assert met.sum() > 100 and away.max() < 5e-3
    assert not len(seen.bounced)


def test_beside_the_surface_the_nearest_pixels_normal_is_seen() -> None:
    camera = camera_at([1.0, 0.5, 2.0], [0.0, 0.0, 0.0], focal=40.0)
    seen = Reflector(ball()).seen_by(camera, CPU)
    normals, near = seen.normals.numpy(), np.zeros(24 * 32, bool)
    assert np.abs(np.linalg.norm(normals, axis=-1) - 1).max() < 1e-2
    assert (normals[0, 0] == normals[0, 1]).all()
    near[seen.near.numpy()] = True
    rows, columns = np.mgrid[:24, :32] + 0.5
    radius = 40 * 0.5 / np.sqrt(camera.center @ camera.center - 0.25)  # of the ball's image about the middle, 16 and 12
    away = np.hypot(columns - 16, rows - 12) - radius
    assert near.reshape(24, 32)[away < reflector_module.BESIDE - 1].all()
    assert not near.reshape(24, 32)[away > reflector_module.BESIDE + 1].any()


def test_a_corner_throws_the_sight_on_where_it_meets_itself() -> None:
    camera = corner_camera()
    seen = Reflector(corner()).seen_by(camera, CPU)
    rays, twice = sights(camera).reshape(-1, 3), np.zeros(24 * 32, bool)
    twice[seen.bounced.numpy()] = True
    expected = np.zeros(24 * 32, bool)
    for pixel, ray in enumerate(rays):
        hits = []
        for axis, other in ((2, 0), (0, 2)):  # the floor, then the wall
            length = -camera.center[axis] / ray[axis]
            place = camera.center + length * ray
            if length > 0 and 0 < place[other] < SIZE and abs(place[1]) < 1:
                reflected = ray.copy()
                reflected[axis] *= -1
                onward = -place[other] / reflected[other]
                again = place + onward * reflected
                hits.append((length, onward > 0 and 0 < again[axis] < SIZE and abs(again[1]) < 1))
        expected[pixel] = bool(hits) and min(hits)[1]
    assert expected.sum() > 50 and (twice == expected).mean() > 0.98
    normals = seen.normals.numpy().reshape(-1, 3).astype(float)[twice]
    reflected = 2 * (normals * -rays[twice]).sum(axis=1, keepdims=True) * normals + rays[twice]
    assert np.abs(reflected - rays[twice] * [-1, 1, -1]).max() < 5e-3


def test_what_a_camera_sees_is_kept_while_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, reflector = corner_camera(), Reflector(corner())
    first = reflector.seen_by(camera, CPU)
    assert reflector.seen_by(camera, CPU) is first
    monkeypatch.setattr(reflector_module, "KEPT", first.size)
    smaller = camera.resized(16, 12)
    again = reflector.seen_by(smaller, CPU)
    assert reflector.seen_by(smaller, CPU) is not again and reflector.seen_by(camera, CPU) is first


def test_a_camera_that_looks_away_sees_nothing() -> None:
    seen = Reflector(ball()).seen_by(camera_at([0.0, 0.0, 2.0], [0.0, 0.0, 4.0]), CPU)
    assert not seen.normals.any() and not len(seen.bounced) and not len(seen.near)
