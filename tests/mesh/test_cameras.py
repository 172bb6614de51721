"""The cameras that the surface is rendered from."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.config import MeshConfig
from mgsr.mesh.cameras import between, surface_cameras
from tests.mesh.shapes import cameras_around


def test_larger_views_see_the_same() -> None:
    given = cameras_around(5)
    larger = surface_cameras(given, MeshConfig(view_scale=2))
    points = np.random.default_rng(0).normal(size=(20, 3)) * 0.3
    for small, large in zip(given, larger, strict=True):
        assert (large.width, large.height) == (192, 192)
        np.testing.assert_allclose(large.project(points)[0], 2 * small.project(points)[0])


def test_all_views_together_keep_to_the_limit() -> None:
    cameras = surface_cameras(cameras_around(20), MeshConfig(view_scale=4, max_pixels=100_000, extra_views=5))
    assert len(cameras) == 25
    assert sum(camera.width * camera.height for camera in cameras) == pytest.approx(100_000, rel=0.05)


def test_views_between_look_at_the_scene_from_as_far() -> None:
    given = cameras_around(20)
    for camera in between(given, 10):
        assert np.linalg.norm(camera.center) == pytest.approx(3, rel=1e-6)
        rotation = camera.cam_from_world[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert depth[0] > 2.5
        assert np.abs(pixel[0] - camera.K[:2, 2]).max() < 20
        assert min(np.linalg.norm(camera.center - other.center) for other in given) > 0.1


def test_no_pairs_no_views_between() -> None:
    assert between(cameras_around(1), 3) == []
