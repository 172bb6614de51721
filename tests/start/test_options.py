"""Options of the start reach the functions that they are for: another value gives the expected other result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mgsr.config import DataConfig, ExpertConfig, Masks, make_config
from mgsr.config.expert import (
    BackgroundPointOptions,
    DepthFillingOptions,
    PointExposureOptions,
    SceneStereoOptions,
    ViewColorOptions,
)
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.geometry.mesh import Mesh
from mgsr.start.background_points import background_points
from mgsr.start.depth_filling import fill_depth
from mgsr.start.point_exposures import point_exposures
from mgsr.start.points import StartSource
from mgsr.start.scene_depths import scene_depths
from mgsr.start.scene_points import scene_points
from mgsr.start.starting_points import starting_points
from mgsr.start.view_colors import median_colors
from tests.data.captures import BallCapture
from tests.mesh.shapes import cameras_around
from tests.start.test_background_points import BALL, room
from tests.start.test_depth_filling import on_lines, plane
from tests.start.test_point_exposures import POINTS, exposed_ball
from tests.start.test_scene_points import unmasked
from tests.stereo.pressed_ball import photographs


def expert(*overrides: str) -> ExpertConfig:
    return make_config(overrides=overrides).expert


@pytest.fixture
def ball_scene(tmp_path: Path) -> Scene:
    return load_scene(BallCapture(views=12).write_plain(tmp_path), DataConfig())


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_the_hull_has_the_resolution_that_is_set(ball_scene: Scene) -> None:
    """Check it on the first surface, where stereo and the hull's residual decide nothing."""
    surfaces = [
        starting_points(ball_scene, 200, seed=0, expert=expert(f"start.resolution={resolution}", "match.neighbours=1"))
        for resolution in (32, 16)
    ]
    fine, coarse = (len(found.surface.vertices) for found in surfaces if found.surface is not None)
    assert coarse < 0.5 * fine


@pytest.mark.usefixtures("neither_bent_nor_moved")
def test_coarser_depths_weigh_what_is_set(ball_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    weights: list[list[np.ndarray]] = []

    def nothing(cameras: object, maps: object, given: list[np.ndarray], *rest: object) -> Mesh:
        weights.append(given)
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))

    monkeypatch.setattr("mgsr.start.masked_surface.fuse_roughly", nothing)
    for share in (0.2, 0.8):
        starting_points(ball_scene, 200, seed=0, expert=expert(f"start.surface.coarse_weight={share}"))
    views = len(ball_scene.train)
    assert all(np.array_equal(*pair) for pair in zip(weights[0][:views], weights[1][:views], strict=True))
    light, heavy = (np.concatenate([each.ravel() for each in found[views:]]) for found in weights)
    assert heavy.max() > 0 and np.allclose(heavy, 4 * light)


def test_too_few_points_of_stereo_make_a_ball(tmp_path: Path) -> None:
    views = unmasked(photographs(True, 0.0, cameras_around(30, side=64)[:14]))
    scene = load_scene(BallCapture(views=12).write_plain(tmp_path), DataConfig(masks=Masks.OFF))
    scene = Scene("ball", Path(), "", views, [], None, scene.user_from_scene)
    for least, source in ((1, StartSource.STEREO), (10**6, StartSource.BALL)):
        assert starting_points(scene, 200, seed=0, expert=expert(f"expert.start.min_points={least}")).source is source


def test_points_of_everything_in_view() -> None:
    views = unmasked(photographs(True, 0.0, cameras_around(30, side=64)[:14]))
    usual = SceneStereoOptions()
    depths = scene_depths(views, seed=0, options=usual)
    count = len(scene_points(views, depths, usual))
    assert (
        count > 100 and len(scene_points(views, depths, replace(usual, spacing=6.0, spacing_filled=0.2))) < 0.5 * count
    )
    assert not len(scene_points(views, depths, replace(usual, min_in_cell=999, min_confirming_filled=999)))
    near = scene_depths(views, seed=0, options=replace(usual, farthest=0.2))
    assert not any((known > 0).any() for known in near.confidence)


def test_background_points() -> None:
    views = room()[::4]
    assert len(background_points(views, BALL, BackgroundPointOptions(seen=999))) == 0
    near = background_points(views, BALL, BackgroundPointOptions(farthest=3.0, directions=1000))
    assert 0 < len(near) <= 1000 and np.linalg.norm(near.positions, axis=1).max() < 3.001


def test_depth_filling() -> None:
    known, image = on_lines(plane(0.001, 0.004, 0.3), 16), np.full((48, 64, 3), 180.0)
    assert np.isfinite(fill_depth(known, image)).all()
    assert np.isnan(fill_depth(known, image, DepthFillingOptions(min_confidence=1.0))).any()


def test_exposures_of_points() -> None:
    train, test, _ = exposed_ball()
    given = train, test, POINTS.positions, POINTS.normals
    assert point_exposures(*given) is not None
    assert point_exposures(*given, PointExposureOptions(min_points=10**6)) is None


def test_colors_of_points() -> None:
    """Check that a point which no view faces takes the colour of its nearest neighbour that one does."""
    train, _, _ = exposed_ball()
    usual = median_colors(train, POINTS.positions, POINTS.normals)
    frontal = median_colors(train, POINTS.positions, POINTS.normals, options=ViewColorOptions(min_cosine=0.99))
    assert len(np.unique(frontal, axis=0)) < 0.5 * len(np.unique(usual, axis=0))
