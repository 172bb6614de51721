"""Written scenes, read by COLMAP and by our readers of other programs' files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData

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
    """Build a scene with two test views, which have the names of training views, as in NeRF-synthetic scenes."""
    views = []
    for i, pose in enumerate(BALL.poses()):
        rgba = BALL.rgba(pose)
        camera = FRAME.camera_to_scene(Camera(BALL.K, pose, SIDE, SIDE))
        views.append(
            View(f"r_{i % 4}", camera, np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3]))
        )
    points = PointCloud(np.random.default_rng(0).normal(size=(5, 3)), np.arange(15, dtype=np.uint8).reshape(5, 3))
    return Scene("ball", None, "plain", views[:4], views[4:], points, FRAME)  # type: ignore[arg-type]


def _left_out(scene: Scene) -> list[str]:
    """Return the scene's notes without that on few photographs."""
    return [note for note in scene.notes if not note.startswith("too few photographs")]


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_colmap_reads_the_cameras_and_points(tmp_path: Path, scene: Scene, scale: float) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    write_scene(tmp_path, scene, scale)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse/0"))
    images = {image.name: image for image in model.images.values()}
    for i, pose in enumerate(BALL.poses()):
        image = images[f"{'train' if i < 4 else 'test'}_r_{i % 4}.png"]
        expected = pose.copy()
        expected[:3, 3] *= scale
        np.testing.assert_allclose(image.cam_from_world().matrix(), expected[:3], atol=1e-9 * scale)
        np.testing.assert_allclose(model.cameras[image.camera_id].calibration_matrix(), BALL.K)
    places = np.array([model.points3D[i + 1].xyz for i in range(5)])
    assert scene.points is not None
    np.testing.assert_allclose(places, FRAME.to_user(scene.points.positions) * scale, rtol=1e-9)
    np.testing.assert_array_equal([model.points3D[i + 1].color for i in range(5)], scene.points.colors)


def test_the_whole_folder_keeps_the_split(tmp_path: Path, scene: Scene) -> None:
    write_scene(tmp_path, scene)
    read = load_scene(tmp_path, DataConfig())
    assert read.format == "nerfstudio" and _left_out(read) == []
    assert [len(read.train), len(read.test)] == [len(scene.train), len(scene.test)] and scene.test


@pytest.mark.parametrize("name", ["colmap", "nerfstudio"])
def test_our_readers_get_back_what_was_written(tmp_path: Path, scene: Scene, name: str) -> None:
    write_scene(tmp_path, scene)
    if name == "nerfstudio":
        shutil.rmtree(tmp_path / "sparse")
    else:
        (tmp_path / "transforms.json").unlink()
    read = load_scene(tmp_path, DataConfig(test_every=100))
    assert read.format == name and read.masked and _left_out(read) == []
    views = {view.name: view for view in read.train + read.test}
    if name == "nerfstudio":
        assert (len(read.train), len(read.test)) == (4, 2)
        views = {view.name: view for view in read.train}
    for i, given in enumerate(scene.train):
        view = views[f"train_r_{i}"]
        np.testing.assert_array_equal(view.image, given.image)
        np.testing.assert_array_equal(view.alpha, given.alpha)
        pose = read.user_from_scene.camera_to_user(view.camera).cam_from_world
        np.testing.assert_allclose(pose, BALL.poses()[i], atol=1e-9)
    assert np.asarray(Image.open(tmp_path / "images/train_r_0.png")).shape == (SIDE, SIDE, 3)


def test_nerfstudio_finds_split_points_and_masks(tmp_path: Path, scene: Scene) -> None:
    """Check what nerfstudio 1.1.5's dataparser asks for: a list for each of its three splits, and points.

    The points are in the file's own frame.
    """
    write_scene(tmp_path, scene, 10.0)
    content = json.loads((tmp_path / "transforms.json").read_text())
    files = [frame["file_path"] for frame in content["frames"]]
    assert files == [f"images/train_r_{i}.png" for i in range(4)] + [f"images/test_r_{i}.png" for i in range(2)]
    assert content["train_filenames"] == files[:4]
    assert content["val_filenames"] == content["test_filenames"] == files[4:]
    assert [frame["mask_path"] for frame in content["frames"]] == [path.replace("images", "masks") for path in files]
    assert all((tmp_path / frame[key]).is_file() for frame in content["frames"] for key in ("file_path", "mask_path"))
    vertex = PlyData.read(str(tmp_path / content["ply_file_path"]))["vertex"]
    places = np.stack([vertex[axis] for axis in "xyz"], 1)
    assert scene.points is not None
    np.testing.assert_allclose(places, FRAME.to_user(scene.points.positions) * 10)
    np.testing.assert_array_equal(np.stack([vertex[name] for name in ("red", "green", "blue")], 1), scene.points.colors)
    shutil.rmtree(tmp_path / "sparse")
    read = load_scene(tmp_path, DataConfig())
    assert read.points is not None
    np.testing.assert_allclose(read.user_from_scene.to_user(read.points.positions), places)


def test_names_are_flat_plain_and_unique(tmp_path: Path, scene: Scene) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    given = ["my photo 1", "my_photo_1", "MY photo 1", "left/m\u00fchle"]
    train = [replace(view, name=name) for view, name in zip(scene.train, given, strict=True)]
    write_scene(tmp_path, replace(scene, train=train, test=[]))
    files = ["my_photo_1.png", "my_photo_1_2.png", "MY_photo_1_3.png", "left_m_hle.png"]
    assert [
        image.name for _, image in sorted(pycolmap.Reconstruction(str(tmp_path / "sparse/0")).images.items())
    ] == files
    assert {path.name for path in (tmp_path / "images").iterdir()} == set(files)
    content = json.loads((tmp_path / "transforms.json").read_text())
    assert not any(key.endswith("_filenames") for key in content), "a scene without tests has no split"


def test_a_scene_without_points_and_masks(tmp_path: Path, scene: Scene) -> None:
    bare = [replace(view, alpha=None) for view in scene.train]
    write_scene(tmp_path, replace(scene, train=bare, points=None))
    assert "ply_file_path" not in json.loads((tmp_path / "transforms.json").read_text())
    assert {path.name for path in tmp_path.iterdir()} >= {"images", "sparse", "transforms.json"}
    assert not (tmp_path / "sparse_pc.ply").exists()


def test_a_written_scene_keeps_its_names_when_it_is_written_again(tmp_path: Path, scene: Scene) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    write_scene(tmp_path / "a", scene)
    shutil.rmtree(tmp_path / "a" / "sparse")
    write_scene(tmp_path / "b", load_scene(tmp_path / "a", DataConfig()))
    first, second = ({path.name for path in (tmp_path / name / "images").iterdir()} for name in "ab")
    assert first == second
