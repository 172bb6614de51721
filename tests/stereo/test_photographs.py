"""Tests of the photographs that stereo compares: their choice, size and neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.data.scene import PHOTOGRAPHS, View
from mgsr.stereo.photographs import StereoPhotographs, stereo_photographs
from tests.mesh.shapes import cameras_around, looking_at_origin


def views(count: int, side: int = 24) -> list[View]:
    """Return photographs of noise, each with a mask that shows the middle quarter."""
    random = np.random.default_rng(0)
    alpha = np.zeros((side, side), np.uint8)
    alpha[side // 4 : 3 * side // 4, side // 4 : 3 * side // 4] = 255
    images = random.integers(0, 256, (count, side, side, 3)).astype(np.uint8)
    cameras = cameras_around(count, side=side)
    return [View(str(k), camera, image, alpha) for k, (camera, image) in enumerate(zip(cameras, images, strict=True))]


def test_pixels_are_shares_with_the_mask_and_cameras_the_views() -> None:
    some = views(5)
    found = stereo_photographs(some)
    for view, image, camera in zip(some, found.images, found.cameras, strict=True):
        assert view.alpha is not None and image.dtype == np.float32 and image.flags.c_contiguous
        np.testing.assert_allclose(image[..., :3], view.image / 255, atol=1e-6)
        np.testing.assert_allclose(image[..., 3], view.alpha / 255, atol=1e-6)
        assert camera is view.camera


def test_without_a_mask_all_is_the_object() -> None:
    assert all(
        (image[..., 3] == 1).all() for image in stereo_photographs([replace(v, alpha=None) for v in views(3)]).images
    )


def test_of_many_views_some_are_chosen_evenly() -> None:
    some = views(3 * PHOTOGRAPHS, side=8)
    found = stereo_photographs(some)
    index = [next(k for k, view in enumerate(some) if view.camera is camera) for camera in found.cameras]
    assert len(index) == PHOTOGRAPHS and index[0] == 0 and index[-1] == len(some) - 1
    assert set(np.diff(index)) <= {2, 3, 4}
    assert len(stereo_photographs(some[:PHOTOGRAPHS]).images) == PHOTOGRAPHS


@pytest.mark.parametrize("masked", [True, False])
def test_large_photographs_are_reduced_by_what_shows_the_object(masked: bool) -> None:
    some = [view if masked else replace(view, alpha=None) for view in views(6, side=80)]
    object_pixels = 6 * (40 * 40 if masked else 80 * 80)
    assert stereo_photographs(some, object_pixels).images[0].shape == (80, 80, 4)
    found = stereo_photographs(some, object_pixels // 16)
    points = np.random.default_rng(1).normal(0, 0.3, (50, 3))
    for view, image, camera in zip(some, found.images, found.cameras, strict=True):
        assert image.shape == (20, 20, 4) and (camera.width, camera.height) == (20, 20)
        means = view.image.reshape(20, 4, 20, 4, 3).mean(axis=(1, 3)) / 255
        np.testing.assert_allclose(image[..., :3], means, atol=1e-5)
        np.testing.assert_allclose(4 * camera.project(points)[0], view.camera.project(points)[0], atol=1e-9)


@pytest.mark.parametrize("shrunk", [1, 4])
def test_unknown_pixels_show_no_object_and_change_nothing(shrunk: int) -> None:
    some = views(4, side=80)
    known = np.arange(80)[:, None] + np.zeros(80) < 42
    noisy = []
    for fill in (0, 200):
        images = [np.where(known[..., None], view.image, fill).astype(np.uint8) for view in some]
        noisy.append([replace(view, image=image, valid_mask=known) for view, image in zip(some, images, strict=True)])
    first, second = (stereo_photographs(each, 4 * 40 * 40 // shrunk**2) for each in noisy)
    for one, other in zip(first.images, second.images, strict=True):
        assert one.shape[0] == 80 // shrunk
        np.testing.assert_array_equal(one, other)
        bottom = 42 // shrunk
        assert (one[bottom:, :, 3] == 0).all() and (one[bottom - 1, :, 3] == 1).any()


def turned(*degrees: float) -> StereoPhotographs:
    """Return photographs from these angles around the object.

    Angles differ between two cameras as the numbers do.
    """
    angles = np.radians(degrees)
    centers = 3 * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    cameras = [looking_at_origin(center, side=8) for center in centers]
    return StereoPhotographs([np.zeros((8, 8, 4), np.float32)] * len(cameras), cameras)


def test_neighbours_are_those_beside_by_the_angle() -> None:
    found = turned(0, 3, 18, -25, 40, -55, 75, 180)
    assert found.neighbours(0, count=3, apart=20.0, farthest=60.0) == [2, 3, 1]
    assert found.neighbours(0, count=3, apart=0.0, farthest=60.0) == [1, 2, 3]
    assert found.neighbours(0, count=99, apart=20.0, farthest=60.0) == [2, 3, 1, 4, 5]
    assert found.neighbours(7, count=99, apart=20.0, farthest=60.0) == []


def test_no_view_is_its_own_neighbour_nor_farther_than_it_may() -> None:
    found = stereo_photographs(views(30))
    away = np.array([camera.center / np.linalg.norm(camera.center) for camera in found.cameras])
    for view in range(30):
        others = found.neighbours(view, count=8, apart=0.0, farthest=60.0)
        assert 1 <= len(others) <= 8 and view not in others
        assert (np.degrees(np.arccos(away[others] @ away[view])) < 60).all()


def test_packed_cameras_carry_points_to_pixels() -> None:
    found = stereo_photographs(views(4))
    points = np.random.default_rng(0).normal(0, 0.3, (20, 3))
    for camera, row in zip(found.cameras, found.packed_cameras, strict=True):
        local = points @ row[4:13].reshape(3, 3).T + row[13:]
        pixels = local[:, :2] / local[:, 2:] * row[:2] + row[2:4]
        np.testing.assert_allclose(pixels, camera.project(points)[0], atol=1e-3)


def test_reduced_photographs_show_the_same_from_the_same_cameras() -> None:
    whole = stereo_photographs(views(3, side=24))
    half = whole.reduced(0.5)
    point = np.array([[0.1, -0.2, 0.15]])
    for image, reduced, camera, smaller in zip(whole.images, half.images, whole.cameras, half.cameras, strict=True):
        means = image.reshape(12, 2, 12, 2, 4).mean(axis=(1, 3))
        np.testing.assert_allclose(reduced, means, atol=1e-6)
        np.testing.assert_allclose(smaller.project(point)[0], camera.project(point)[0] / 2, atol=1e-9)
