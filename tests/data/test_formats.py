"""Blender and plain scenes: cameras, splits, masks, and the frame that results go back to."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsr.config import DataConfig, Masks
from mgsr.data.camera import Camera
from mgsr.data.capture import Format
from mgsr.data.formats import all_formats
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, View
from mgsr.errors import ConfigError, SceneError
from tests.data.captures import SIDE, BallCapture, edit_json, save
from tests.optional import present

CENTER = np.array([5.0, -2.0, 1.0])


def user_camera(scene: Scene, view: View) -> Camera:
    return scene.user_from_scene.camera_to_user(view.camera)


@pytest.fixture
def ball() -> BallCapture:
    return BallCapture(center=CENTER, scale=2.0)


def test_formats_are_found_in_order_of_rank() -> None:
    formats = all_formats()
    assert [kind.name for kind in formats][:3] == ["plain", "blender", "colmap"]
    assert all(isinstance(kind, Format) for kind in formats)


@pytest.mark.parametrize("kind", ["plain", "blender"])
def test_cameras_come_back_in_the_users_frame(tmp_path: Path, ball: BallCapture, kind: str) -> None:
    scene = load_scene(getattr(ball, f"write_{kind}")(tmp_path), DataConfig())
    assert scene.format == kind
    poses = {tuple(np.round(pose[:3, 3], 6)) for pose in ball.poses()}
    for view in scene.train + scene.test:
        camera = user_camera(scene, view)
        assert tuple(np.round(camera.cam_from_world[:3, 3], 6)) in poses
        np.testing.assert_allclose(camera.K, ball.K)


@pytest.mark.parametrize("kind", ["plain", "blender"])
def test_projection_agrees_with_the_written_camera(tmp_path: Path, ball: BallCapture, kind: str) -> None:
    """Check the projection against homogeneous P = K [R|t] of what was written, in the user's frame."""
    root = getattr(ball, f"write_{kind}")(tmp_path)
    scene = load_scene(root, DataConfig(test_every=100))
    points = CENTER + np.random.default_rng(1).normal(size=(50, 3))
    for view, pose in zip(sorted(scene.train, key=lambda v: int(v.name.split("_")[-1])), ball.poses(), strict=True):
        homogeneous = np.c_[points, np.ones(50)] @ (ball.K @ pose[:3]).T
        expected = homogeneous[:, :2] / homogeneous[:, 2:]
        pixels, depth = view.camera.project(scene.user_from_scene.to_scene(points))
        np.testing.assert_allclose(pixels, expected, atol=1e-6)
        np.testing.assert_allclose(depth * scene.user_from_scene.scale, homogeneous[:, 2], rtol=1e-9)


def test_blender_splits_and_names(tmp_path: Path, ball: BallCapture) -> None:
    scene = load_scene(ball.write_blender(tmp_path, test=3), DataConfig())
    assert (len(scene.train), len(scene.test)) == (9, 3)
    assert scene.test[0].name == scene.train[0].name == "r_0"


def test_blender_angle_of_view_alone(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_blender(tmp_path)

    def only_angle(content: dict[str, Any]) -> None:
        for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
            del content[key]
        content["camera_angle_x"] = 0.9

    edit_json(root / "transforms_train.json", only_angle)
    K = load_scene(root, DataConfig(masks=Masks.OFF)).train[0].camera.K
    focal = SIDE / 2 / math.tan(0.45)
    np.testing.assert_allclose(K, [[focal, 0.0, SIDE / 2], [0.0, focal, SIDE / 2], [0.0, 0.0, 1.0]])


def test_blender_val_is_the_test_where_there_is_no_other(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_blender(tmp_path, test=2)
    (root / "transforms_test.json").rename(root / "transforms_val.json")
    assert len(load_scene(root, DataConfig()).test) == 2


def test_every_nth_view_is_a_test_by_name(tmp_path: Path, ball: BallCapture) -> None:
    scene = load_scene(ball.write_plain(tmp_path), DataConfig(test_every=5))
    assert [view.name for view in scene.test] == ["000", "005", "010"]
    assert "001" in [view.name for view in scene.train]


def test_few_views_all_train(tmp_path: Path) -> None:
    scene = load_scene(BallCapture(views=5).write_plain(tmp_path), DataConfig())
    assert (len(scene.train), len(scene.test)) == (5, 0)


def test_split_of_the_plain_form(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_plain(tmp_path)
    edit_json(root / "cameras.json", lambda content: content["views"][4].update(split="test"))
    scene = load_scene(root, DataConfig())
    assert [view.name for view in scene.test] == ["004"]
    assert len(scene.train) == 11


def test_a_scene_one_folder_down_is_found(tmp_path: Path, ball: BallCapture) -> None:
    ball.write_plain(tmp_path / "outer" / "inner")
    assert load_scene(tmp_path / "outer", DataConfig()).name == "inner"


def test_a_scene_beside_files_that_are_none_of_it(tmp_path: Path, ball: BallCapture) -> None:
    ball.write_plain(tmp_path / "outer/scene")
    (tmp_path / "outer/README.txt").write_text("by")
    (tmp_path / "outer/desktop.ini").write_text("")
    (tmp_path / "outer/renders").mkdir()
    assert load_scene(tmp_path / "outer", DataConfig()).name == "scene"


def test_two_scenes_in_one_folder_are_named(tmp_path: Path, ball: BallCapture) -> None:
    for name in ("can", "ball"):
        ball.write_plain(tmp_path / name)
    with pytest.raises(SceneError, match=r"2 scenes \(ball, can\); choose one of them"):
        load_scene(tmp_path, DataConfig())


def test_what_else_a_folder_could_be_read_as_is_told(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_plain(ball.write_blender(tmp_path))
    scene = load_scene(root, DataConfig())
    assert scene.format == "plain"
    assert scene.notes == (
        "the scene is read from cameras.json (plain); transforms_train.json (blender) in the same folder is ignored",
    )


def test_images_of_the_same_name_in_two_folders_keep_both(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_plain(tmp_path)
    (root / "photos/left").mkdir()
    shutil.move(root / "photos/001.png", root / "photos/left/002.png")
    edit_json(root / "cameras.json", lambda content: content["views"][1].update(image="photos/left/002.png"))
    names = [view.name for view in load_scene(root, DataConfig()).train]
    assert "left_002" in names and "002" in names


# Masks


def test_alpha_is_the_mask(tmp_path: Path, ball: BallCapture) -> None:
    scene = load_scene(ball.write_plain(tmp_path), DataConfig())
    assert scene.masked
    view = next(view for view in scene.train if view.name == "001")
    np.testing.assert_array_equal(present(view.alpha) > 0, ball.mask(ball.poses()[1]))


def test_masks_off_puts_views_on_white(tmp_path: Path, ball: BallCapture) -> None:
    scene = load_scene(ball.write_plain(tmp_path), DataConfig(masks=Masks.OFF))
    view = next(view for view in scene.train if view.name == "001")
    outside = ~ball.mask(ball.poses()[1])
    assert not scene.masked and view.alpha is None
    assert (view.image[outside] == 255).all() and (view.image[~outside] == [200, 100, 50]).all()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".png.png"])
def test_masks_folder(tmp_path: Path, ball: BallCapture, suffix: str) -> None:
    root = ball.write_plain(tmp_path, mode="RGB")
    ball.write_masks(root)
    for path in list((root / "masks").iterdir()):
        save(path.with_name(path.stem + suffix), ball.rgba(ball.poses()[int(path.stem)])[..., 3], "L")
        if suffix != ".png":
            path.unlink()
    scene = load_scene(root, DataConfig(masks=Masks.OBJECT))
    view = scene.train[0]
    assert scene.masked
    np.testing.assert_array_equal(present(view.alpha) > 127, ball.mask(ball.poses()[int(view.name)]))
    assert (view.image == 7).any(), "the photograph outside the mask stays as it is"


def test_masks_of_zero_and_one(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_plain(tmp_path, mode="RGB")
    for i, pose in enumerate(ball.poses()):
        save(root / f"masks/{i:03d}.png", ball.mask(pose).astype(np.uint8), "L")
    assert present(load_scene(root, DataConfig()).train[0].alpha).max() == 255


def test_alpha_of_255_everywhere_is_no_mask(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_plain(tmp_path)
    for path in (root / "photos").iterdir():
        save(path, np.full((SIDE, SIDE, 4), 255, np.uint8), "RGBA")
    scene = load_scene(root, DataConfig())
    assert not scene.masked and scene.train[0].alpha is None
    with pytest.raises(SceneError, match="masks=object: every mask is completely white"):
        load_scene(root, DataConfig(masks=Masks.OBJECT))


def test_one_view_without_mask_leaves_all_without(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_plain(tmp_path)
    save(root / "photos/003.png", ball.rgba(ball.poses()[3]), "RGB")
    scene = load_scene(root, DataConfig())
    assert all(view.alpha is None for view in scene.train + scene.test)
    with pytest.raises(SceneError, match="masks=object: view '003' has none"):
        load_scene(root, DataConfig(masks=Masks.OBJECT))


# Sizes


def test_large_images_are_reduced_and_the_camera_follows(tmp_path: Path, ball: BallCapture) -> None:
    scene = load_scene(ball.write_plain(tmp_path), DataConfig(max_side=40))
    view = scene.train[0]
    assert view.alpha is not None
    assert view.image.shape == (40, 40, 3) and view.alpha.shape == (40, 40)
    np.testing.assert_allclose(view.camera.K[:2], ball.K[:2] * 40 / SIDE)
    assert (view.image[view.alpha > 0] >= [195, 95, 45]).all(), "the colours behind alpha 0 must not bleed in"


def test_a_scaled_copy_of_the_images_scales_the_camera(tmp_path: Path, ball: BallCapture) -> None:
    root = ball.write_blender(tmp_path)

    def enlarge(content: dict[str, Any]) -> None:
        content.update(w=128, h=128, fl_x=160.0, fl_y=180.0, cx=60.0, cy=70.0)

    edit_json(root / "transforms_train.json", enlarge)
    np.testing.assert_allclose(load_scene(root, DataConfig()).train[0].camera.K, ball.K)


def test_settings_out_of_range(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="max_side"):
        load_scene(tmp_path, DataConfig(max_side=0))


def test_shared_scene_is_about_in_its_unit_ball(shared_data: Path) -> None:
    scene = load_scene(shared_data / "scenes" / "spot_soft", DataConfig())
    assert (len(scene.train), len(scene.test), scene.format) == (48, 8, "blender")
    info = json.loads((shared_data / "scenes/spot_soft/transforms_test.json").read_text())
    expected = np.array(info["frames"][0]["transform_matrix"])[:3, 3]
    view = next(view for view in scene.test if view.name == "r_0")
    np.testing.assert_allclose(user_camera(scene, view).center, expected, atol=1e-6)
