"""The unit ball: around a known ball, with and without masks, and back again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mgsr.config import DataConfig, Masks
from mgsr.data.camera import Camera
from mgsr.data.normalise import focus, normalisation, smallest_ball
from mgsr.data.readers import load_scene
from mgsr.data.scene import PointCloud, View
from tests.data.captures import SIDE, BallCapture, look_at, save

CENTER = np.array([5.0, -2.0, 1.0])


def bare_views(ball: BallCapture) -> list[View]:
    image = np.zeros((SIDE, SIDE, 3), np.uint8)
    return [View(str(i), Camera(ball.K, pose, SIDE, SIDE), image) for i, pose in enumerate(ball.poses())]


@pytest.mark.parametrize("scale", [0.01, 1.0, 300.0])
def test_masks_give_the_ball(tmp_path: Path, scale: float) -> None:
    ball = BallCapture(views=40, center=CENTER * scale, scale=scale)
    frame = load_scene(ball.write_plain(tmp_path), DataConfig()).user_from_scene
    # The hull of 35 silhouettes sticks out of the ball by a few per cent, and pixels are 1/30 of its radius.
    assert frame.scale == pytest.approx(ball.radius * scale, rel=0.1)
    np.testing.assert_allclose(frame.offset, ball.center, atol=0.05 * scale)
    assert np.linalg.norm(frame.offset - ball.center) + ball.radius * scale <= 1.01 * frame.scale


@pytest.mark.parametrize(
    ("focal", "views"),
    [
        *[(60, 8), (80, 12), (105, 20)],
        *(
            pytest.param(focal, views, marks=pytest.mark.slow)
            for focal in (60, 80, 105)
            for views in (8, 12, 20, 40)
            if (focal, views) not in ((60, 8), (80, 12), (105, 20))
        ),
    ],
)
def test_masks_give_the_ball_however_large_it_is_in_the_images(tmp_path: Path, views: int, focal: int) -> None:
    """Check the ball against the hull of all masks, worked out point by point.

    No point is in it that any view has outside its mask or its image. Where the ball fills the images (105: nine tenths
    of the side), what lies beside them is not its either.
    """
    K = np.array([[focal, 0, 32.0], [0, focal, 32], [0, 0, 1]])
    ball = BallCapture(views=views, center=CENTER, K=K)
    scene = load_scene(ball.write_plain(tmp_path), DataConfig(test_every=1000))
    points = np.stack(np.meshgrid(*[np.linspace(-1.2, 1.2, 60)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + CENTER
    inside = np.ones(len(points), bool)
    for pose in ball.poses():
        local = points @ pose[:3, :3].T + pose[:3, 3]
        columns, rows = np.floor(local[:, :2] / local[:, 2:] * focal + 32).astype(int).T
        shown = (columns >= 0) & (columns < SIDE) & (rows >= 0) & (rows < SIDE)
        inside[~shown] = False
        inside[shown] &= ball.mask(pose)[rows[shown], columns[shown]]
    center, radius = smallest_ball(points[inside])
    frame = scene.user_from_scene
    assert frame.scale == pytest.approx(radius, rel=0.08)
    np.testing.assert_allclose(frame.offset, center, atol=0.05)


def test_an_object_that_images_cut_off_keeps_what_lies_beyond_them(tmp_path: Path) -> None:
    """Check that close-ups, half the views, which show a part of the object, do not carve the rest."""
    ball, near = (BallCapture(views=16, K=np.array([[f, 0, 32.0], [0, f, 32], [0, 0, 1]])) for f in (80, 200))
    root = ball.write_plain(tmp_path)
    content = json.loads((root / "cameras.json").read_text())
    for i, view in enumerate(content["views"][::2]):
        view["K"] = near.K.tolist()
        save(root / view["image"], near.rgba(near.poses()[2 * i]), "RGBA")
    (root / "cameras.json").write_text(json.dumps(content))
    frame = load_scene(root, DataConfig(test_every=1000)).user_from_scene
    assert frame.scale == pytest.approx(ball.radius, rel=0.1)
    np.testing.assert_allclose(frame.offset, ball.center, atol=0.05)


def test_cameras_alone_give_what_they_see_in_common() -> None:
    ball = BallCapture(center=CENTER, scale=2.0)
    frame = normalisation(bare_views(ball), None, [])
    np.testing.assert_allclose(frame.offset, CENTER, atol=1e-9)
    # The narrowest side: the right edge at (64-30)/80 and the lower at 29/90; 6 is the distance.
    assert frame.scale == pytest.approx(6 * np.sin(np.arctan(29 / 90)), rel=1e-6)


def test_far_points_do_not_matter() -> None:
    ball = BallCapture(center=CENTER)
    rng = np.random.default_rng(0)
    near = CENTER + rng.normal(size=(500, 3)) * 0.15
    far = rng.normal(size=(50, 3)) * 1e4
    alone = normalisation(bare_views(ball), PointCloud(near, np.zeros((500, 3), np.uint8)), [])
    both = normalisation(bare_views(ball), PointCloud(np.r_[near, far], np.zeros((550, 3), np.uint8)), [])
    assert both.scale == pytest.approx(alone.scale, rel=1e-6)
    assert 0.3 < both.scale < 0.6


def test_the_ball_moves_to_the_points_beside_the_focus() -> None:
    rng = np.random.default_rng(0)
    can = CENTER + np.array([0.4, 0, 0]) + rng.normal(size=(2000, 3)) * 0.1
    table = np.c_[rng.uniform(-4, 4, (500, 2)) + CENTER[:2], np.full(500, CENTER[2] - 0.3)]
    cloud = PointCloud(np.r_[can, table], np.zeros((2500, 3), np.uint8))
    frame = normalisation(bare_views(BallCapture(center=CENTER)), cloud, [])
    assert np.quantile(np.linalg.norm(frame.to_scene(can), axis=1), 0.98) < 1
    np.testing.assert_allclose(frame.offset, CENTER + np.array([0.4, 0, 0]), atol=0.05)


def test_one_camera_that_looks_elsewhere() -> None:
    ball = BallCapture(views=20, center=CENTER)
    poses = ball.poses()
    poses[4] = look_at(CENTER + np.array([3, 0, 0]), CENTER + np.array([3, 9, 0.1]))
    origins = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
    point = focus(origins, np.array([pose[2, :3] for pose in poses]))
    assert np.linalg.norm(point - CENTER) < 0.01


def test_cameras_that_look_into_one_direction() -> None:
    poses = [look_at(np.array([x, -5.0, z]), np.array([x, 0.0, z])) for x in (-1.0, 0, 1) for z in (-0.5, 0, 0.5)]
    K = np.array([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]])
    views = [
        View(str(i), Camera(K, pose, SIDE, SIDE), np.zeros((SIDE, SIDE, 3), np.uint8)) for i, pose in enumerate(poses)
    ]
    rng = np.random.default_rng(1)
    points = rng.uniform([-1, 1, -1], [1, 3, 1], (400, 3))
    frame = normalisation(views, PointCloud(points, np.zeros((400, 3), np.uint8)), [])
    np.testing.assert_allclose(frame.offset, [0, 2, 0], atol=0.2)
    blind = normalisation(views, None, [])
    assert blind.offset[1] > -5 and blind.scale > 0


def test_smallest_ball_of_a_lopsided_cloud() -> None:
    points = np.array([[-2.0, 0, 0], [2, 0, 0], [1, 1, 0], [1, -1, 0], [1, 0, 1]])
    center, radius = smallest_ball(points)
    np.testing.assert_allclose(center, 0, atol=0.01)
    assert radius == pytest.approx(2, rel=0.01)


def test_round_trip_of_points_and_cameras(tmp_path: Path) -> None:
    ball = BallCapture(center=CENTER, scale=2.0)
    frame = load_scene(ball.write_plain(tmp_path), DataConfig()).user_from_scene
    points = np.random.default_rng(0).normal(size=(20, 3)) * 10
    np.testing.assert_allclose(frame.to_user(frame.to_scene(points)), points, atol=1e-12)
    camera = Camera(ball.K, ball.poses()[0], SIDE, SIDE)
    inner = frame.camera_to_scene(camera)
    np.testing.assert_allclose(frame.camera_to_user(inner).cam_from_world, camera.cam_from_world, atol=1e-12)
    np.testing.assert_allclose(inner.project(frame.to_scene(points))[0], camera.project(points)[0], atol=1e-8)
    np.testing.assert_allclose(inner.center, frame.to_scene(camera.center[None])[0], atol=1e-12)


@pytest.mark.parametrize(
    "name",
    ["bunny_flash", *(pytest.param(n, marks=pytest.mark.slow) for n in ("spot_soft", "teapot_hdr", "wingnut_dark"))],
)
@pytest.mark.parametrize("masks", list(Masks)[:2])
def test_shared_scenes_lie_in_the_unit_ball(shared_data: Path, name: str, masks: Masks) -> None:
    root = shared_data / "scenes" / name
    frame = load_scene(root, DataConfig(masks=masks)).user_from_scene
    vertices = frame.to_scene(trimesh.load_mesh(root / "mesh_gt.ply").vertices)
    assert np.linalg.norm(vertices, axis=1).max() < 1.02
    assert 0.85 < frame.scale < 1.15 and np.linalg.norm(frame.offset) < 0.2
