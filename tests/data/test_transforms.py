"""nerfstudio's and instant-ngp's transforms.json, written by hand from their documentation."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from mgsr.config import DataConfig
from mgsr.data.capture import Split
from mgsr.data.lens import Lens
from mgsr.data.photo_files import SceneFolder
from mgsr.data.readers import load_scene
from mgsr.data.usable import usable_photos
from mgsr.errors import SceneError
from tests.data.captures import BallCapture, edit_json
from tests.data.reading import draw, project, read_capture, read_strictly

BALL = BallCapture(views=6, center=np.array([1.0, -2, 3]))
# z to y, as ns-process-data writes it.
APPLIED = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]])


@pytest.fixture
def root(tmp_path: Path) -> Path:
    frames = []
    for i, pose in enumerate(BALL.poses()):
        draw(tmp_path / f"images/frame_{i}.png")
        opengl = np.linalg.inv(pose) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/frame_{i}.png", "transform_matrix": opengl.tolist()})
    content = {"fl_x": 80, "fl_y": 90, "cx": 30, "cy": 35, "w": 64, "h": 64, "camera_model": "OPENCV", "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    return tmp_path


def edit(root: Path, **values: Any) -> None:
    edit_json(root / "transforms.json", lambda content: content.update(values))


def test_cameras(root: Path) -> None:
    for photo, pose in zip(read_capture(root, "nerfstudio").photos, BALL.poses(), strict=True):
        np.testing.assert_allclose(photo.cam_from_world, pose, atol=1e-12)
        np.testing.assert_array_equal(photo.K, BALL.K)
        assert photo.lens is None and photo.split is None


def test_a_frames_own_intrinsics_and_lens_overrule_the_files(root: Path) -> None:
    edit_json(root / "transforms.json", lambda content: content["frames"][2].update(fl_x=100, k1=0.1, k3=0.01))
    photos = read_capture(root, "nerfstudio").photos
    assert [photo.K[0, 0] for photo in photos] == [80, 80, 100, 80, 80, 80]
    assert isinstance(photos[2].lens, Lens)
    assert photos[2].lens.k1 == 0.1 and photos[2].lens.higher == (0.01, 0) and photos[1].lens is None


def test_a_frames_own_angle_of_view_overrules_the_files_focal_lengths(root: Path) -> None:
    """Check the frame's own angle: tan(45 degrees) is 1, half of 64 pixels."""
    edit_json(root / "transforms.json", lambda content: content["frames"][2].update(camera_angle_x=math.pi / 2))
    edit_json(root / "transforms.json", lambda content: content["frames"][3].update(camera_angle_x=1, fl_x=70, fl_y=75))
    photos = read_capture(root, "nerfstudio").photos
    np.testing.assert_allclose([photos[i].K[[0, 1], [0, 1]] for i in (1, 2, 3)], [[80, 90], [32, 32], [70, 75]])


@pytest.mark.parametrize(
    ("angle", "message"),
    [
        (
            1e-9,
            r"frame 2 .*focal lengths of 0\.003 to 3000 times .*, got 6\.4e\+10 and 6\.4e\+10 pixels in an image of 64",
        ),
        (math.pi - 1e-9, "frame 2 .*focal lengths of"),
        (40, "frame 2 .*camera_angle_x: expected an angle between 0 and pi radians, got 40; fix the file"),
    ],
)
def test_angles_that_no_lens_has(root: Path, angle: float, message: str) -> None:
    edit_json(root / "transforms.json", lambda content: content["frames"][2].update(camera_angle_x=angle))
    folder = SceneFolder.at(root)
    photos, (note,) = usable_photos(read_capture(root, "nerfstudio"), folder)
    assert len(photos) == 5 and re.search(message, note)


@pytest.mark.parametrize("side", [0, 1e300, -3])
def test_sizes_that_no_image_has(root: Path, side: float) -> None:
    edit(root, w=side)
    with pytest.raises(SceneError, match=r"frame 0 .*: expected image sides from 1 to 1000000 pixels, got \S{1,12}"):
        load_scene(root, DataConfig())


def test_a_photograph_that_is_there_twice_is_refused(root: Path) -> None:
    edit_json(root / "transforms.json", lambda content: content["frames"].append(dict(content["frames"][1])))
    message = (
        r"frame 6 \(images/frame_1\.png\): .* the same photograph as .*frame 1 \(images/frame_1\.png\); remove one"
    )
    with pytest.raises(SceneError, match=message):
        read_capture(root, "nerfstudio")


def test_blenders_test_photographs_must_not_train(tmp_path: Path) -> None:
    BALL.write_blender(tmp_path, test=2)
    frame = json.loads((tmp_path / "transforms_train.json").read_text())["frames"][3]
    edit_json(tmp_path / "transforms_test.json", lambda content: content["frames"].append(frame))
    message = r"transforms_test\.json, frame 2 .*the same photograph as transforms_train\.json, frame 3"
    with pytest.raises(SceneError, match=message):
        read_capture(tmp_path, "blender")


@pytest.mark.parametrize("way", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheyes(root: Path, way: dict[str, str | bool]) -> None:
    edit(root, k1=0.05, **way)
    lens = read_capture(root, "nerfstudio").photos[0].lens
    assert isinstance(lens, Lens) and lens.fisheye


def test_results_go_back_to_the_frame_before_the_applied_transform(root: Path) -> None:
    """Check that the point a camera sees in its middle is the ball's centre in the original frame."""
    scale, pad = 0.5, np.vstack([APPLIED, [0, 0, 0, 1]])

    def apply(content: dict[str, Any]) -> None:
        content.update(applied_transform=APPLIED.tolist(), applied_scale=scale, ply_file_path="points.ply")
        for frame in content["frames"]:
            moved = pad @ np.array(frame["transform_matrix"])
            moved[:3, 3] *= scale
            frame["transform_matrix"] = moved.tolist()

    edit_json(root / "transforms.json", apply)
    points = np.array([BALL.center, [0.5, 0, 0]])
    moved = scale * (points @ APPLIED[:, :3].T)
    trimesh.PointCloud(moved, colors=[[10, 20, 30, 255]] * 2).export(root / "points.ply")
    capture = read_capture(root, "nerfstudio")
    for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
        np.testing.assert_allclose(photo.cam_from_world, pose, atol=1e-12)
        np.testing.assert_allclose(project(photo, points[:1]), [BALL.K[:2, 2]], atol=1e-9)
    assert capture.points is not None
    np.testing.assert_allclose(capture.points.positions, points, atol=1e-6)
    np.testing.assert_array_equal(capture.points.colors[0], [10, 20, 30])


def test_splits(root: Path) -> None:
    edit(root, train_filenames=["images/frame_0.png"], test_filenames=["./images/frame_3.png"])
    splits = [photo.split for photo in read_capture(root, "nerfstudio").photos]
    assert splits == [Split.TRAIN] * 3 + [Split.TEST] + [Split.TRAIN] * 2


def test_named_masks(root: Path) -> None:
    draw(root / "elsewhere/m.png")
    edit_json(root / "transforms.json", lambda content: content["frames"][1].update(mask_path="elsewhere/m.png"))
    assert read_capture(root, "nerfstudio").photos[1].mask == root / "elsewhere/m.png"


def test_instant_ngp_leaves_out_extensions_and_photographs(root: Path) -> None:
    """Check that a missing photograph is left out, as instant-ngp's loader does, and that too many are refused."""

    def as_ngp(content: dict[str, Any]) -> None:
        content.update(aabb_scale=4, camera_angle_x=0.7)
        for frame in content["frames"]:
            frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")

    edit_json(root / "transforms.json", as_ngp)
    (root / "images/frame_1.png").unlink()
    capture = read_capture(root, "nerfstudio")
    assert [photo.image.name for photo in capture.photos] == [f"frame_{i}.png" for i in (0, 2, 3, 4, 5)]
    assert [str(error) for error in capture.missing] == ["./images/frame_1 is missing"]
    for i in (2, 3, 4):
        (root / f"images/frame_{i}.png").unlink()
    with pytest.raises(SceneError, match=r"only 2 of the 6 .* exist \(\./images/frame_1 is missing\); copy them"):
        load_scene(root, DataConfig())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"camera_model": "EQUIRECTANGULAR"},
            "camera_model EQUIRECTANGULAR is not supported: a panorama .* perspective photographs",
        ),
        ({"is_latlong": True}, "is not supported: a panorama"),
        ({"camera_model": "ORTHO"}, "camera_model ORTHO is not supported; expected one of"),
        ({"k5": 0.1}, "frame 0 .*distortion k5 is not supported; undistort"),
        ({"fl_x": "80"}, "frame 0 .*fl_x: expected a number, got '80'"),
        ({"fl_x": 10**400}, "frame 0 .*fl_x: expected a number"),
        ({"applied_scale": 0}, "applied_scale: expected a number above 0"),
        (
            {"applied_transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
            "applied_transform: .*a pose that is not rigid",
        ),
        ({"applied_transform": 3}, "applied_transform: expected a 3x4 matrix"),
        ({"train_filenames": 3}, "expected train_filenames, val_filenames and test_filenames to be lists of paths"),
        (
            {"train_filenames": ["a.png", "./b.png"], "val_filenames": ["b.png"]},
            r"b\.png is in both train_filenames and val_filenames; remove it from one",
        ),
        ({"ply_file_path": 3}, "ply_file_path: expected the path of a file, got '3'"),
    ],
)
def test_refusals(root: Path, values: dict[str, list[list[int] | str] | str | bool | float], message: str) -> None:
    edit(root, **values)
    with pytest.raises(SceneError, match=message):
        read_strictly(root, "nerfstudio")


@pytest.mark.parametrize("name", ["./", "images/.."])
def test_the_folder_itself_is_no_photograph(root: Path, name: str) -> None:
    """Check that a file named as the folder, with an image's suffix, is not taken for it (found by fuzzing)."""
    draw(root.with_name(root.name + ".png"))
    edit_json(root / "transforms.json", lambda content: content["frames"][2].update(file_path=name))
    capture = read_capture(root, "nerfstudio")
    assert len(capture.photos) == 5
    (lost,) = capture.lost
    assert re.search(r"photograph 3: expected the path of an image, got './'|images/\.\. is missing", str(lost))


def test_the_longest_names_are_looked_for(root: Path) -> None:
    edit_json(root / "transforms.json", lambda content: content["frames"][2].update(file_path="n" * 240))
    assert len(read_capture(root, "nerfstudio").photos) == 5


def test_points_that_are_no_ply(root: Path) -> None:
    (root / "points.ply").write_text("ply\nformat ascii 1.0\nelement vertex 5\n")
    edit(root, ply_file_path="points.ply")
    with pytest.raises(SceneError, match=r"points\.ply: expected a PLY file with vertices"):
        read_capture(root, "nerfstudio")
