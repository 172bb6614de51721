"""Where the object lies, as a file beside the photographs says; and masks that a run has written, given back."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mgsr.config import DataConfig, Object
from mgsr.config.expert import DataOptions
from mgsr.data.readers import load_scene
from mgsr.errors import SceneError
from tests.data.captures import BallCapture

BOX = [-0.5, -1, 0, 0.5, 1, 2]


def capture(folder: Path, content: str | None, masks: bool = False) -> Path:
    """Write a capture, and object.json beside its cameras."""
    ball = BallCapture()
    ball.write_plain(folder, "RGB")
    if masks:
        ball.write_masks(folder)
    if content is not None:
        (folder / "object.json").write_text(content)
    return folder


def test_box_and_ground(tmp_path: Path) -> None:
    place = load_scene(
        capture(tmp_path, json.dumps({"box": BOX, "ground": [0, 0, 2, -1], "agreement": {}}))
    ).object_place
    assert place is not None and place.ground is not None
    assert place.box.tolist() == [BOX[:3], BOX[3:]] and place.ground.tolist() == [0, 0, 1, -0.5]


def test_in_an_archive_beside_the_scene(tmp_path: Path) -> None:
    folder = capture(tmp_path / "scene", None)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for path in folder.rglob("*.*"):
            archive.write(path, f"inner/{path.relative_to(folder)}")
        archive.writestr("object.json", json.dumps({"box": BOX}))
    place = load_scene(tmp_path / "a.zip", DataConfig(confined=True)).object_place
    assert place is not None and place.box.tolist() == [BOX[:3], BOX[3:]] and place.ground is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "object.json: expected JSON with the object's box, got an unreadable file"),
        ('{"box": [0, 0, 0, 1, 1]}', "object.json: box: expected 6 numbers x0, y0, z0, x1, y1, z1"),
        ('{"box": [0, 0, 0, 1, 1, NaN]}', "object.json: box: expected 6 numbers"),
        ('{"box": [0, 0, 0, 1, 1, "2"]}', "object.json: box: expected 6 numbers"),
        ('{"box": {"x": 1}}', "object.json: box: expected 6 numbers"),
        ('{"box": [0, 0, 3, 1, 1, 2]}', "object.json: box: expected x0 < x1, y0 < y1 and z0 < z1"),
        ('{"box": [0, 0, 0, 1, 1, 2], "ground": [1, 2]}', "object.json: ground: expected 4 numbers a, b, c, d"),
        (
            '{"box": [0, 0, 0, 1, 1, 2], "ground": [0, 0, 0, 1]}',
            "object.json: ground: expected a normal that is not zero",
        ),
    ],
)
def test_a_file_that_is_wrong(tmp_path: Path, content: str, said: str) -> None:
    folder = capture(tmp_path, content)
    with pytest.raises(SceneError) as refused:
        load_scene(folder)
    assert str(refused.value).startswith(said)
    assert load_scene(folder, DataConfig(object=Object.OFF)).object_place is None, "it is not read"


@pytest.mark.parametrize("content", ["[1]", '{"name": "vase"}'])
def test_a_file_of_another_program(tmp_path: Path, content: str) -> None:
    scene = load_scene(capture(tmp_path, content))
    assert scene.object_place is None
    assert any("object.json has no box" in note for note in scene.notes)


def test_masks_that_a_search_has_found_stand_on_their_ground(tmp_path: Path) -> None:
    alone = load_scene(capture(tmp_path / "alone", None, masks=True))
    assert alone.masked and alone.ground is None and alone.mask_dissent == 0
    folder = capture(tmp_path / "both", json.dumps({"box": BOX, "ground": [0, 0, 1, 0.8]}), masks=True)
    scene = load_scene(folder, options=DataOptions(mask_dissent=0.3))
    assert scene.masked and scene.ground is not None and scene.mask_dissent == 3 and len(scene.train) == 10
    on_ground = scene.user_from_scene.to_scene(np.array([[3.0, -2, -0.8]]))
    assert on_ground @ scene.ground[:3] + scene.ground[3] == pytest.approx(0)


def test_masks_of_undistorted_photographs_are_not_undistorted_again(tmp_path: Path) -> None:
    ball = BallCapture(K=np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]))
    ball.write_blender(tmp_path)
    path = tmp_path / "transforms_train.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"k1": -0.15}))
    for image in (tmp_path / "train").glob("*.png"):
        Image.open(image).convert("RGB").save(image)
    bare = load_scene(tmp_path)
    assert all(view.alpha is None and view.image.shape[:2] != (64, 64) for view in bare.train)
    rng = np.random.default_rng(0)
    (tmp_path / "masks").mkdir()
    masks = {}
    for view in bare.train + bare.test:
        mask = np.zeros(view.image.shape[:2], np.uint8)
        mask[20:-20, 20:-20] = 255
        mask[24:30, 24:30] = rng.integers(0, 256, (6, 6))
        masks[view.name] = mask
        Image.fromarray(mask).save(tmp_path / "masks" / f"{view.name}.png")
    for view in load_scene(tmp_path).train:
        np.testing.assert_array_equal(view.alpha, masks[view.name])
