"""Stereo, on a painted ball whose masks are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgsr.data.scene import PointCloud, View
from mgsr.start.plane_sweep import sweep_planes
from tests.start.test_photo_carving import CAP, photographs

RADIUS = 0.7


def unmasked(views: list[View]) -> list[View]:
    return [replace(view, alpha=None) for view in views]


def heights(positions: np.ndarray) -> np.ndarray:
    """How far [P] points lie outside the ball with the flat cap."""
    return np.maximum(np.linalg.norm(positions, axis=1) - RADIUS, positions[:, 2] - CAP)


@pytest.fixture(scope="module")
def matte() -> list[View]:
    return unmasked(photographs(pattern=True, gloss=0.0))


@pytest.fixture(scope="module")
def found(matte: list[View]) -> PointCloud:
    return sweep_planes(matte)


def test_points_lie_on_the_ball_and_all_around_it(found: PointCloud) -> None:
    assert len(found.positions) > 5000
    off = heights(found.positions)[found.positions[:, 2] < CAP - 0.1]  # a bowl is pressed into the cap
    # Planes are 0.03 apart, and windows that see the ball's edge put it there before and behind.
    assert abs(np.median(off)) < 0.02 and np.percentile(np.abs(off), 90) < 0.045
    directions = found.positions / np.linalg.norm(found.positions, axis=1, keepdims=True)
    around = np.random.default_rng(0).normal(size=(500, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    assert ((directions @ around.T).max(axis=0) > np.cos(np.radians(10))).mean() > 0.9


def test_colors_are_the_photographs(found: PointCloud, matte: list[View]) -> None:
    view, outwards = matte[7], found.positions / np.linalg.norm(found.positions, axis=1, keepdims=True)
    towards = view.camera.center - found.positions
    facing = (towards * outwards).sum(axis=1) > 0.8 * np.linalg.norm(towards, axis=1)
    columns, rows = view.camera.project(found.positions[facing])[0].astype(int).T
    off = np.abs(found.colors[facing].astype(float) - view.image[rows, columns])
    assert facing.sum() > 200 and np.median(off) < 15


def test_what_has_no_contrast_shows_nothing() -> None:
    views = [replace(view, image=np.full_like(view.image, 90)) for view in unmasked(photographs(True, 0.0)[::6])]
    assert len(sweep_planes(views).positions) == 0


def test_cameras_that_share_nothing_show_nothing(matte: list[View]) -> None:
    assert len(sweep_planes(matte[:1]).positions) == 0
