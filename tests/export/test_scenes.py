"""Written scenes, read by COLMAP and by our readers of other programs' files."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from PIL import Image

from mgsr.config import DataConfig
from mgsr.data.camera import Camera
from mgsr.data.readers import load_scene
from mgsr.data.scene import PointCloud, Scene, Similarity, View
from mgsr.export.scenes import write_scene
from tests.data.captures import SIDE, BallCapture

BALL = BallCapture(views=6, center=np.array([5.0, -2, 1]), scale=2.0)
FRAME = Similarity(2.5, np.array([5.0, -2, 1]))


@pytest.fixture
def scene() -> Scene:
    """Two test views, which have the names of training views, as in NeRF-synthetic scenes."""
    views = []
    for i, pose in enumerate(BALL.poses()):
        rgba = BALL.rgba(pose)
        camera = FRAME.camera_to_scene(Camera(BALL.K, pose, SIDE, SIDE))
        views.append(
            View(f"r_{i % 4}", camera, np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3]))
        )
    points = PointCloud(np.random.default_rng(0).normal(size=(5, 3)), np.arange(15, dtype=np.uint8).reshape(5, 3))
    return Scene("ball", None, "plain", views[:4], views[4:], points, FRAME)  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_colmap_reads_the_cameras_and_points(tmp_path, scene, scale):
    pycolmap = pytest.importorskip("pycolmap")
    write_scene(tmp_path, scene, scale)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse/0"))
    images = {image.name: image for image in model.images.values()}
    for i, pose in enumerate(BALL.poses()):
        image = images[f"{'train' if i < 4 else 'test'}/r_{i % 4}.png"]
        expected = pose.copy()
        expected[:3, 3] *= scale
        np.testing.assert_allclose(image.cam_from_world().matrix(), expected[:3], atol=1e-9 * scale)
        np.testing.assert_allclose(model.cameras[image.camera_id].calibration_matrix(), BALL.K)
    places = np.array([model.points3D[i + 1].xyz for i in range(5)])
    np.testing.assert_allclose(places, FRAME.to_user(scene.points.positions) * scale, rtol=1e-9)
    np.testing.assert_array_equal([model.points3D[i + 1].color for i in range(5)], scene.points.colors)


@pytest.mark.parametrize("name", ["colmap", "nerfstudio"])
def test_our_readers_get_back_what_was_written(tmp_path, scene, name):
    write_scene(tmp_path, scene)
    if name == "nerfstudio":
        shutil.rmtree(tmp_path / "sparse")
    read = load_scene(tmp_path, DataConfig(test_every=100))
    assert read.format == name and read.masked and read.notes == ()
    views = {view.name: view for view in read.train + read.test}
    if name == "nerfstudio":
        assert (len(read.train), len(read.test)) == (4, 2)
        views = {view.name: view for view in read.train}
    for i, given in enumerate(scene.train):
        view = views[f"train_r_{i}" if name == "colmap" else f"r_{i}"]
        np.testing.assert_array_equal(view.image, given.image)
        np.testing.assert_array_equal(view.alpha, given.alpha)
        pose = read.user_from_scene.camera_to_user(view.camera).cam_from_world
        np.testing.assert_allclose(pose, BALL.poses()[i], atol=1e-9)
    assert np.asarray(Image.open(tmp_path / "images/train/r_0.png")).shape == (SIDE, SIDE, 3)
