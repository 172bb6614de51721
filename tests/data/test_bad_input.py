"""Bad input of each kind raises one SceneError that names the file and the cure."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsr.config import DataConfig, Masks
from mgsr.data.readers import load_scene
from mgsr.errors import SceneError
from tests.data.captures import SIDE, BallCapture, edit_json, save


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return BallCapture().write_plain(tmp_path / "scene")


def refuses(root: Path, match: str, config: DataConfig = DataConfig()) -> None:  # noqa: B008 (frozen)
    with pytest.raises(SceneError, match=match):
        load_scene(root, config)


def leaves_out(root: Path, match: str, count: int = 1) -> None:
    """Check that the scene loads without its bad photographs, and that a note says why."""
    scene = load_scene(root, DataConfig())
    assert len(scene.train) + len(scene.test) == 12 - count
    assert any(re.search(f"^{count} of 12 photographs .*skipped: .*({match})", note) for note in scene.notes)


def edit_view(root: Path, index: int = 3, **values: Any) -> None:
    edit_json(root / "cameras.json", lambda content: content["views"][index].update(values))


def pose_with(change: Callable[[np.ndarray], object]) -> list[list[float]]:
    pose = BallCapture().poses()[3]
    change(pose)
    rows: list[list[float]] = pose.tolist()
    return rows


def test_no_such_path(tmp_path: Path) -> None:
    refuses(tmp_path / "nowhere", "nowhere: this folder or file does not exist")


def test_a_file_that_is_no_archive(tmp_path: Path) -> None:
    (tmp_path / "scene.rar").write_text("x")
    refuses(tmp_path / "scene.rar", r"scene\.rar: expected a folder or an archive \(\.zip")


def test_empty_folder(tmp_path: Path) -> None:
    refuses(tmp_path, "the folder is empty. MGSR looked for: cameras.json")


def test_unrecognised_folder_lists_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    refuses(tmp_path, "no known scene.*cameras.json.*transforms_train.json.*sparse/0")


def test_another_programs_cameras_json_is_not_ours(tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text('[{"id": 0}]')
    refuses(tmp_path, "no known scene")


def test_empty_scene(root: Path) -> None:
    edit_json(root / "cameras.json", lambda content: content["views"].clear())
    refuses(root, "the scene has no views")


def test_single_view(root: Path) -> None:
    edit_json(root / "cameras.json", lambda content: content["views"].__delitem__(slice(1, None)))
    refuses(root, "expected at least 2 training views, got 1")


def test_missing_images_of_the_plain_form(root: Path) -> None:
    (root / "photos/003.png").unlink()
    scene = load_scene(root, DataConfig())
    assert scene.notes == ("1 of 12 photographs of cameras.json skipped: photos/003.png is missing",)
    for path in sorted((root / "photos").iterdir())[:6]:
        path.unlink()
    refuses(
        root, r"only 5 of the 12 photographs named by cameras\.json exist \(photos/000\.png is missing\); copy them"
    )


def test_few_missing_images_are_left_out_and_many_are_an_error(tmp_path: Path) -> None:
    root = BallCapture().write_blender(tmp_path)
    for number in (2, 5):
        (root / f"train/r_{number}.png").unlink()
    scene = load_scene(root, DataConfig())
    assert scene.notes == ("2 of 12 photographs of transforms_train.json skipped: ./train/r_2 is missing",)
    assert len(scene.train) + len(scene.test) == 10
    for path in sorted((root / "train").iterdir())[:5]:
        path.unlink()
    refuses(root, r"only 5 of the 12 photographs named by transforms_train\.json exist \(\./train/r_0 is missing")


def test_damaged_image(root: Path) -> None:
    path = root / "photos/003.png"
    path.write_bytes(path.read_bytes()[:60])
    leaves_out(root, r"003\.png")


def test_not_an_image(root: Path) -> None:
    (root / "photos/003.png").write_text("hello")
    leaves_out(root, r"003\.png: this file is not a readable image")


def test_image_outside_the_folder(root: Path) -> None:
    edit_view(root, image="../../etc/hosts.png")
    leaves_out(root, r"\.\./\.\./etc/hosts\.png is missing")


def test_image_that_is_no_text(root: Path) -> None:
    edit_view(root, image=5)
    leaves_out(root, "photograph 4: expected the path of an image, got '5'")


def test_two_images_of_the_same_name(root: Path) -> None:
    save(root / "photos/004.jpg", np.zeros((SIDE, SIDE, 3), np.uint8), "RGB")
    edit_view(root, image="photos/004.jpg")
    scene = load_scene(root, DataConfig(masks=Masks.OFF))
    names = [view.name for view in scene.train + scene.test]
    assert len(names) == 12 and {"004_jpg", "004_png"} < set(names)


def test_nan_pose(root: Path) -> None:
    edit_view(root, cam_from_world=pose_with(lambda pose: pose.__setitem__((0, 3), np.nan)))
    leaves_out(root, r"view 3 \(photos/003\.png\): the pose has NaN")


def test_a_uniform_scale_of_poses_is_divided_out(root: Path) -> None:
    """Check that photographs stay the same where a pose takes points x to 0.01 (R x + t)."""
    expected = load_scene(root, DataConfig())
    scaled = np.diag([0.01, 0.01, 0.01, 1])
    poses = [(scaled @ pose).tolist() for pose in BallCapture().poses()]
    edit_json(
        root / "cameras.json",
        lambda content: [v.update(cam_from_world=p) for v, p in zip(content["views"], poses, strict=True)],
    )
    scene = load_scene(root, DataConfig())
    for view, other in zip(scene.train, expected.train, strict=True):
        np.testing.assert_allclose(view.camera.cam_from_world, other.camera.cam_from_world, atol=1e-12)
    assert scene.notes == (
        "12 of 12 photographs with a scale in the pose (100); MGSR divides it out, which keeps positions and "
        "directions",
    )


@pytest.mark.parametrize("count", [1, 12])
def test_stretched_poses(root: Path, count: int) -> None:
    """Check that a look-at matrix with axes of unequal lengths is refused."""
    stretch = np.diag([1, 1.3, 1, 1])

    def edit(content: dict[str, Any]) -> None:
        for view in content["views"][:count]:
            view["cam_from_world"] = (stretch @ np.array(view["cam_from_world"])).tolist()

    edit_json(root / "cameras.json", edit)
    message = "expected a rotation and a translation, got a pose that is not rigid"
    if count == 1:
        leaves_out(root, message)
    else:
        cure = "Divide each axis of a look-at matrix by its length"
        refuses(root, f"12 of 12 photographs cannot be used; the first: .*view 0.*{message}.*{cure}")


def test_poses_of_three_rows_or_in_one_list(root: Path) -> None:
    expected = load_scene(root, DataConfig())

    def edit(content: dict[str, Any]) -> None:
        for i, view in enumerate(content["views"]):
            pose = view["cam_from_world"]
            view["cam_from_world"] = pose[:3] if i % 2 else np.ravel(pose).tolist()

    edit_json(root / "cameras.json", edit)
    scene = load_scene(root, DataConfig())
    for view, other in zip(scene.train, expected.train, strict=True):
        np.testing.assert_array_equal(view.camera.cam_from_world, other.camera.cam_from_world)
    assert scene.notes == ()


def test_mirrored_pose(root: Path) -> None:
    edit_view(root, cam_from_world=pose_with(lambda pose: pose.__setitem__(0, -pose[0])))
    leaves_out(root, "view 3.*expected a rotation, got a reflection")


def test_pose_of_wrong_shape(root: Path) -> None:
    edit_view(root, cam_from_world=[[1, 0, 0, 0]] * 2)
    leaves_out(root, "view 3.*cam_from_world: expected a 4x4 or 3x4 matrix, got shape")


def test_missing_pose(root: Path) -> None:
    edit_view(root, cam_from_world=None)
    leaves_out(root, "view 3.*cam_from_world: expected a 4x4 or 3x4 matrix")


@pytest.mark.parametrize(
    ("K", "message"),
    [
        ([[0, 0, 32], [0, 90, 32], [0, 0, 1]], "got a focal length of zero"),
        ([[-80, 0, 32], [0, 90, 32], [0, 0, 1]], "got a negative focal length"),
        ([[80, 0, 32], [0, 90, 32], [0, 0, 0]], "got the singular matrix"),
        ([[80, 2, 32], [0, 90, 32], [0, 0, 1]], "the intrinsics have skew"),
        ([[80, 0, None], [0, 90, 32], [0, 0, 1]], "NaN or infinite|matrix of numbers"),
        ([[80, 0, 32], [0, 90, 32]], "K: expected a 3x3 matrix, got shape"),
    ],
)
def test_bad_intrinsics(root: Path, K: list[list[int | None]], message: str) -> None:
    edit_view(root, K=K)
    leaves_out(root, f"view 3.*({message})")


def test_mask_of_another_size(root: Path) -> None:
    save(root / "masks/003.png", np.zeros((10, 20), np.uint8), "L")
    leaves_out(root, r"003\.png: 20x10 pixels, but its image has 64x64")


def test_named_mask_that_is_missing(root: Path) -> None:
    edit_view(root, mask="masks/gone.png")
    leaves_out(root, r"view 3.*its mask masks/gone\.png is missing; add it")


def test_masks_that_exclude_each_other(tmp_path: Path) -> None:
    ball = BallCapture()
    root = ball.write_plain(tmp_path, mode="RGB")
    for i in range(ball.views):
        block = np.zeros((SIDE, SIDE), np.uint8)
        block[:8, :8] = 255
        save(root / f"masks/{i:03d}.png", block, "L")
    refuses(root, r"masks of the training views have no common visual hull.*masks=off")
    assert not load_scene(root, DataConfig(masks=Masks.OFF)).masked


def test_black_masks(tmp_path: Path) -> None:
    ball = BallCapture()
    root = ball.write_plain(tmp_path, mode="RGB")
    for i in range(ball.views):
        save(root / f"masks/{i:03d}.png", np.zeros((SIDE, SIDE), np.uint8), "L")
    refuses(
        root,
        "masks of 10 of 10 training views are empty: values of 128 and more are the object, and the mask of '001' "
        "has at most 0;",
    )


def test_a_few_black_masks_leave_their_views_out(tmp_path: Path) -> None:
    ball = BallCapture()
    root = ball.write_plain(tmp_path, mode="RGB")
    ball.write_masks(root)
    for name in ("000", "003"):  # of a test view and of a training view
        save(root / f"masks/{name}.png", np.zeros((SIDE, SIDE), np.uint8), "L")
    scene = load_scene(root, DataConfig())
    assert scene.notes == ("the masks of 1 of 10 training views are empty ('003'); these views are skipped",)
    assert [len(scene.train), len(scene.test)] == [9, 1]
    all_train = DataConfig(test_every=1000)
    frame = load_scene(root, all_train).user_from_scene
    edit_json(root / "cameras.json", lambda content: [content["views"].pop(place) for place in (3, 0)])
    assert frame.scale == load_scene(root, all_train).user_from_scene.scale


@pytest.mark.parametrize(
    ("focal", "change"),
    [
        (55, lambda mask: 255 - mask),
        (100, lambda mask: 255 - mask),
        (55, lambda mask: np.roll(mask, SIDE // 3, axis=1)),
    ],
)
def test_a_mask_that_contradicts_the_others_leaves_its_view_out(
    tmp_path: Path, focal: int, change: Callable[..., Any]
) -> None:
    """Check that the view is left out, also where the object nearly fills the image.

    Then most places are outside of most images.
    """
    ball = BallCapture(K=np.array([[focal, 0, 32.0], [0, focal, 32], [0, 0, 1]]))
    root = ball.write_plain(tmp_path, mode="RGB")
    ball.write_masks(root)
    assert load_scene(root, DataConfig()).notes == ()
    save(root / "masks/003.png", change(ball.rgba(ball.poses()[3])[..., 3]), "L")
    scene = load_scene(root, DataConfig())
    assert "003" not in [view.name for view in scene.train] and len(scene.train) == 9
    assert scene.notes == (
        "the masks of 1 of 10 training views exclude places that the others count as the object ('003'); these views "
        "are skipped",
    )


def test_masks_that_some_views_have_are_told_of(tmp_path: Path) -> None:
    ball = BallCapture()
    root = ball.write_plain(tmp_path, mode="RGB")
    ball.write_masks(root)
    (root / "masks/003.png").unlink()
    scene = load_scene(root, DataConfig())
    assert not scene.masked
    assert scene.notes[0] == "9 of 10 training views have a mask, but '003' has none, so masks are not used"


def test_masks_of_other_names_are_told_of(tmp_path: Path) -> None:
    ball = BallCapture()
    root = ball.write_plain(tmp_path, mode="RGB")
    ball.write_masks(root)
    for path in sorted((root / "masks").iterdir()):
        path.rename(path.with_name(f"object-{path.name}"))
    note, _ = load_scene(root, DataConfig()).notes
    assert note == (
        "masks/object-000.png and the files beside it belong to no photograph; rename it to 000.png to use it as a mask"
    )
    (few,) = load_scene(root, DataConfig(masks=Masks.OFF)).notes
    assert few.startswith(
        "too few photographs: at least half of the 10 training photographs have no neighbour within 35"
    )


def test_all_cameras_at_one_place(root: Path) -> None:
    pose = BallCapture().poses()[0].tolist()
    edit_json(root / "cameras.json", lambda content: [view.update(cam_from_world=pose) for view in content["views"]])
    refuses(root, "all cameras have the same position")


def test_bad_json_names_the_line(root: Path) -> None:
    (root / "cameras.json").write_text('{"views": [\n{]}')
    refuses(root, r"cameras\.json: not valid JSON at line 2")


def test_json_nested_too_deep(root: Path) -> None:
    (root / "cameras.json").write_text("[" * 10_000_000)
    refuses(root, r"cameras\.json: the JSON is nested too deep")


def test_json_number_without_end(root: Path) -> None:
    (root / "cameras.json").write_text('{"views": ' + "1" * 10_000 + "}")
    refuses(root, r"cameras\.json: this file is not JSON text: .*digits")


def test_json_with_half_a_character(root: Path) -> None:
    """Check that half a character is refused: Python's strings can hold it, but file names and terminals can't."""
    edit_view(root, image="\ud800.png")
    refuses(root, r"cameras\.json: this file is not JSON text: .*surrogates not allowed; export it again")


def test_json_with_nan_in_the_intrinsics(root: Path) -> None:
    edit_view(root, K=[[float("nan"), 0, 30], [0, 90, 35], [0, 0, 1]])
    leaves_out(root, "view 3.*the intrinsics have NaN or infinite numbers")


@pytest.mark.parametrize("place", [(-3, 35), (30, 65), (-300, 300)])
def test_parts_that_were_cut_out_of_larger_photographs(root: Path, place: tuple[int, int]) -> None:
    edit_json(
        root / "cameras.json",
        lambda content: [v.update(K=[[80, 0, place[0]], [0, 90, place[1]], [0, 0, 1]]) for v in content["views"]],
    )
    scene = load_scene(root, DataConfig(masks=Masks.OFF))
    np.testing.assert_array_equal(scene.train[0].camera.K[:2, 2], place)
    assert (
        "12 of 12 photographs treated as crops of larger ones, because the principal point lies outside the image"
        in scene.notes
    )


def test_a_principal_point_that_no_photograph_has(root: Path) -> None:
    edit_view(root, K=[[80, 0, 5000], [0, 90, 35], [0, 0, 1]])
    leaves_out(root, r"view 3.*the principal point \(5000, 35\) lies 62\.1 focal lengths from the centre")


def test_inverted_masks(root: Path) -> None:
    for i, pose in enumerate(BallCapture().poses()):
        save(root / f"photos/{i:03d}.png", BallCapture().rgba(pose), "RGB")
        save(root / f"masks/{i:03d}.png", 255 - BallCapture().rgba(pose)[..., 3], "L")
    refuses(root, "the masks are inverted, white around the object and black on it; make them white on the object")


def test_unknown_split(root: Path) -> None:
    edit_view(root, split="val")
    refuses(root, "view 3: split: expected 'train' or 'test', got 'val'")


def test_blender_without_focal_length(tmp_path: Path) -> None:
    root = BallCapture().write_blender(tmp_path)
    edit_json(root / "transforms_train.json", lambda content: (content.pop("fl_x"), content.pop("fl_y")))
    refuses(root, "frame 0.*expected camera_angle_x .*, got no focal length")


def test_blender_without_frames(tmp_path: Path) -> None:
    (tmp_path / "transforms_train.json").write_text("[]")
    refuses(tmp_path, r"transforms_train\.json: expected an object with a list 'frames'")


def test_camera_of_another_shape_of_image(tmp_path: Path) -> None:
    root = BallCapture().write_blender(tmp_path)
    edit_json(root / "transforms_train.json", lambda content: content.update(w=128))
    refuses(root, r"the camera is for 128x64 pixels, but r_\d+\.png has 64x64")
