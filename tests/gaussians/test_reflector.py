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


def sights(camera: Camera, rows_in_pixel: int = 1) -> np.ndarray:
    """Return unit world directions [H x N, W x N, 3] in which the middles of N x N parts of all pixels look."""
    camera = camera.resized(camera.width * rows_in_pixel, camera.height * rows_in_pixel)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.cam_from_world[:3, :3]
    directions: np.ndarray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return directions


def image_of(pixels: torch.Tensor, samples: torch.Tensor, camera: Camera) -> np.ndarray:
    """Return samples [P,N,N,3] as an image [H x N, W x N, 3], zero beside the pixels [P]."""
    rows = samples.shape[1]
    image = np.zeros((camera.height * camera.width, rows, rows, 3))
    image[pixels.numpy()] = samples.numpy()
    image = image.reshape(camera.height, camera.width, rows, rows, 3).transpose(0, 2, 1, 3, 4)
    return image.reshape(camera.height * rows, camera.width * rows, 3)


def test_the_number_of_samples_follows_the_objects_size_in_the_image() -> None:
    middle = camera_at([0.0, 0.0, 2.0], [0.0, 0.0, 0.0], focal=1.0)
    for across, rows in ((20, 4), (128, 4), (140, 4), (180, 3), (300, 2), (510, 2), (520, 1), (2000, 1)):
        K = np.array([[2.0 * across, 0, 16], [0, 2.0 * across, 12], [0, 0, 1]])  # the ball is 1 wide and 2 away
        camera = Camera(K, middle.cam_from_world, 32, 24)
        assert Reflector(ball()).seen_by(camera, CPU).samples.shape[1:] == (rows, rows, 3)


@pytest.mark.parametrize("rows", [1, 3])
def test_a_ball_has_its_normals_and_mirrors_nothing_of_itself(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reflector_module, "MOST_ROWS", rows)
    camera = camera_at([1.0, 0.5, 2.0], [0.0, 0.0, 0.0], focal=40.0)
    seen = Reflector(ball()).seen_by(camera, CPU)
    rays, middle = sights(camera, rows), camera.center
    along = (rays * middle).sum(axis=-1)
    root = along**2 - middle @ middle + 0.25
    met = root > 0.02  # but for the rim, where the facets show
    places = middle + rays * (-along - np.sqrt(np.maximum(root, 0)))[..., None]
    normals = image_of(seen.pixels, seen.samples, camera)
    lengths = np.linalg.norm(normals, axis=-1)
    away = np.linalg.norm(normals / np.maximum(lengths, 1e-9)[..., None] - places / 0.5, axis=-1)[met]
    assert met.sum() > 100 * rows**2 and away.max() < 5e-3
    assert not len(seen.bounced) and not len(seen.bounced_pixels)


def test_the_samples_of_a_pixel_have_a_weight_of_1_together() -> None:
    camera = camera_at([1.0, 0.5, 2.0], [0.0, 0.0, 0.0], focal=40.0)
    seen = Reflector(ball()).seen_by(camera, CPU)
    lengths = seen.samples.double().norm(dim=-1)
    assert (lengths.sum(dim=(1, 2)) - 1).abs().max() < 2e-3
    partly = (lengths == 0).any(dim=2).any(dim=1)  # pixels on the contour, and those beside with their samples
    assert 0.1 < partly.double().mean() < 0.9
    shares = lengths[partly].flatten(1)
    assert ((shares == 0) | ((shares - shares.amax(dim=1, keepdim=True)).abs() < 1e-3)).all()


def test_beside_the_surface_the_nearest_pixels_samples_are_seen() -> None:
    camera = camera_at([1.0, 0.5, 2.0], [0.0, 0.0, 0.0], focal=40.0)
    seen = Reflector(ball()).seen_by(camera, CPU)
    near = np.zeros((24, 32), bool)
    near.ravel()[seen.pixels.numpy()] = True
    rows, columns = np.mgrid[:24, :32] + 0.5
    radius = 40 * 0.5 / np.sqrt(camera.center @ camera.center - 0.25)  # of the ball's image about the middle, 16 and 12
    away = np.hypot(columns - 16, rows - 12) - radius
    assert near[away < reflector_module.BESIDE - 1].all()
    assert not near[away > reflector_module.BESIDE + 1].any()
    # Along the row of the ball's middle, the nearest pixel is the last that shows the ball.
    order = {int(pixel): place for place, pixel in enumerate(seen.pixels)}
    middle = 12 * 32
    last = max(column for column in range(32) if away[12, column] < -0.5)
    far = seen.samples[order[middle + last + 3]]
    assert any(torch.equal(far, seen.samples[order[middle + column]]) for column in (last, last + 1))


def test_a_corner_throws_the_sight_on_where_it_meets_itself() -> None:
    camera, rows = corner_camera(), reflector_module.MOST_ROWS
    seen = Reflector(corner()).seen_by(camera, CPU)
    rays = sights(camera, rows).reshape(-1, 3)
    turned = image_of(seen.bounced_pixels, seen.bounced, camera).reshape(-1, 3)
    lengths = np.linalg.norm(turned, axis=1)
    near = image_of(seen.pixels, torch.ones_like(seen.samples), camera).reshape(-1, 3)[:, 0] > 0
    expected, met = np.zeros((2, len(rays)), bool)
    for sample, ray in enumerate(rays):
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
        met[sample] = bool(hits)
        expected[sample] = bool(hits) and min(hits)[1]
    assert near[met].all()
    twice = lengths > 0
    assert expected.sum() > 50 and (twice == expected)[met].mean() > 0.98
    normals = turned[met & twice] / lengths[met & twice][:, None]
    reflected = 2 * (normals * -rays[met & twice]).sum(axis=1, keepdims=True) * normals + rays[met & twice]
    assert np.abs(reflected - rays[met & twice] * [-1, 1, -1]).max() < 5e-3
    both = image_of(seen.pixels, seen.samples, camera).reshape(-1, 3)
    assert not both[twice].any() and both[met & ~twice].any(axis=1).all()


def test_what_a_camera_sees_is_kept_while_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, reflector = corner_camera(), Reflector(corner())
    first = reflector.seen_by(camera, CPU)
    assert reflector.seen_by(camera, CPU) is first
    monkeypatch.setattr(reflector_module, "KEPT", first.size)
    smaller = camera.resized(16, 12)
    again = reflector.seen_by(smaller, CPU)
    assert reflector.seen_by(smaller, CPU) is not again and reflector.seen_by(camera, CPU) is first


def test_prepared_views_are_those_that_are_seen() -> None:
    cameras = [corner_camera(), corner_camera().resized(20, 15), camera_at([2.0, 0.1, 2.0], [0.6, 0.0, 0.5])]
    prepared, asked = Reflector(corner()), Reflector(corner())
    prepared.prepare(cameras, CPU)
    for camera in cameras:
        ready, own = prepared.seen_by(camera, CPU), asked.seen_by(camera, CPU)
        assert prepared.seen_by(camera, CPU) is ready
        assert torch.equal(ready.samples, own.samples) and torch.equal(ready.bounced, own.bounced)
        assert torch.equal(ready.pixels, own.pixels) and torch.equal(ready.bounced_pixels, own.bounced_pixels)


def test_a_camera_that_looks_away_sees_nothing() -> None:
    seen = Reflector(ball()).seen_by(camera_at([0.0, 0.0, 2.0], [0.0, 0.0, 4.0]), CPU)
    assert not len(seen.pixels) and not len(seen.samples) and not len(seen.bounced_pixels) and not len(seen.bounced)
