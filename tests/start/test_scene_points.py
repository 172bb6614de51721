"""Stereo of everything in view, on a painted ball whose masks are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.data.scene import PointCloud, View
from mgsr.geometry.raycast import pixel_rays
from mgsr.start.scene_depths import scene_depths
from mgsr.start.scene_points import scene_points
from tests.mesh.shapes import cameras_around
from tests.stereo.pressed_ball import CAP, photographs, with_noise

RADIUS = 0.7
CAMERAS = cameras_around(60, side=160)


def unmasked(views: list[View]) -> list[View]:
    return [replace(view, alpha=None) for view in views]


def heights(positions: np.ndarray) -> np.ndarray:
    """Return how far [P] points lie outside the ball with the flat cap."""
    outside: np.ndarray = np.maximum(np.linalg.norm(positions, axis=1) - RADIUS, positions[:, 2] - CAP)
    return outside


def found_points(views: list[View]) -> PointCloud:
    """Find points on everything in view."""
    return scene_points(views, scene_depths(views, seed=0))


@pytest.fixture(scope="module")
def matte() -> list[View]:
    return unmasked(photographs(True, 0.0, CAMERAS))


@pytest.fixture(scope="module")
def fewer() -> list[View]:
    return unmasked(photographs(True, 0.0, cameras_around(24, side=112)))


@pytest.fixture(scope="module")
def found(fewer: list[View]) -> PointCloud:
    return found_points(fewer)


def test_points_lie_on_the_ball_and_all_around_it(found: PointCloud) -> None:
    assert len(found.positions) > 5000
    off = heights(found.positions)[found.positions[:, 2] < CAP - 0.1]  # a bowl is pressed into the cap
    # A pixel is 0.02 wide there. Patches that see the ball's edge beside it must not put the background there.
    assert abs(np.median(off)) < 0.006 and np.percentile(np.abs(off), 90) < 0.009 and np.percentile(off, 99) < 0.01
    directions = found.positions / np.linalg.norm(found.positions, axis=1, keepdims=True)
    around = np.random.default_rng(0).normal(size=(500, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    assert ((directions @ around.T).max(axis=0) > np.cos(np.radians(10))).mean() > 0.98


def test_colors_are_the_photographs(found: PointCloud, fewer: list[View]) -> None:
    view, outwards = fewer[7], found.positions / np.linalg.norm(found.positions, axis=1, keepdims=True)
    towards = view.camera.center - found.positions
    facing = (towards * outwards).sum(axis=1) > 0.8 * np.linalg.norm(towards, axis=1)
    columns, rows = view.camera.project(found.positions[facing])[0].astype(int).T
    off = np.abs(found.colors[facing].astype(float) - view.image[rows, columns])
    assert facing.sum() > 200 and np.median(off) < 15


@pytest.mark.slow
def test_a_background_has_its_place_behind_the_ball(matte: list[View]) -> None:
    wall = 6.0
    found = found_points([in_front_of_a_wall(view, wall) for view in matte]).positions
    away = np.linalg.norm(found, axis=1)
    near, far = away < 1.1, away > 3
    assert near.sum() > 5000 and far.sum() > 1000
    assert (near | far).mean() > 0.98  # next to nothing floats between
    assert np.percentile(np.abs(heights(found[near])), 90) < 0.06
    assert abs(np.median(away[far]) / wall - 1) < 0.05 and np.percentile(np.abs(away[far] / wall - 1), 80) < 0.2


def in_front_of_a_wall(view: View, radius: float) -> View:
    """Return the view with a painted sphere of this radius around everything, cameras too."""
    rays = pixel_rays(view.camera)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    center = view.camera.center
    along = -(rays @ center)
    far = center + rays * (along + np.sqrt(along**2 + radius**2 - center @ center))[..., None]
    spots = 0.5 + 0.5 * np.sin(7 * far[..., 0] + 1) * np.sin(8 * far[..., 1]) * np.cos(6 * far[..., 2])
    behind = np.round(255 * (0.2 + 0.6 * spots[..., None] * np.array([0.4, 0.9, 0.6]))).astype(np.uint8)
    ball = (view.image > 0).any(axis=-1, keepdims=True)
    return replace(view, image=np.where(ball, view.image, behind))


@pytest.mark.slow
def test_a_place_without_contrast_continues_what_lies_around_it(matte: list[View]) -> None:
    towards, wide = np.array([0.0, 1.0, 0.0]), np.radians(16)
    found = found_points([with_a_plain_place(view, towards, np.cos(wide)) for view in matte]).positions
    directions = found / np.linalg.norm(found, axis=1, keepdims=True)
    inside = directions @ towards > np.cos(0.7 * wide)
    assert inside.sum() > 20 and np.percentile(np.abs(heights(found[inside])), 90) < 0.06
    there = np.random.default_rng(0).normal(size=(5000, 3))
    there = there / np.linalg.norm(there, axis=1, keepdims=True)
    there = there[there @ towards > np.cos(wide)]
    assert ((directions @ there.T).max(axis=0) > np.cos(np.radians(8))).mean() > 0.9


def with_a_plain_place(view: View, towards: np.ndarray, cosine: float) -> View:
    """Return the view with one colour where the ball faces a direction."""
    rays = pixel_rays(view.camera)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    center = view.camera.center
    along = rays @ center
    inside = along**2 + RADIUS**2 - center @ center
    hit = center - rays * (along + np.sqrt(np.maximum(inside, 0)))[..., None]
    plain = (inside > 0) & (hit @ towards > cosine * RADIUS)
    return replace(view, image=np.where(plain[..., None], np.array([120, 90, 60], np.uint8), view.image))


def test_what_has_no_contrast_shows_nothing() -> None:
    views = unmasked(photographs(True, 0.0, cameras_around(10, side=96)))
    even = [replace(view, image=np.full_like(view.image, 90)) for view in views]
    assert len(found_points(even).positions) == 0


def test_cameras_that_share_nothing_show_nothing(fewer: list[View]) -> None:
    assert len(found_points(fewer[:1]).positions) == 0


@pytest.mark.slow
def test_noise_at_unknown_pixels_changes_nothing(matte: list[View]) -> None:
    """Check that points come from known pixels, and are to the byte the same whatever stands at others."""
    near = sorted(matte, key=lambda view: np.linalg.norm(view.camera.center - matte[0].camera.center))[:12]
    first, second = (found_points([with_noise(view, seed) for view in near]) for seed in (1, 2))
    assert len(first.positions) > 200
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.colors, second.colors)
    assert abs(np.median(heights(first.positions))) < 0.02
