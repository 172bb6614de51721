"""A capture with inexact cameras, from the command to the results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mgsr.config import make_config
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import MgsrError
from mgsr.pipeline.preprocess import load_again
from mgsr.pipeline.result_files import with_known_cameras, write_cameras
from tests.cli.spheres import write_spheres


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return load_scene(write_spheres(tmp_path / "spheres", size=32, train=6, test=2), make_config().data)


def moved(scene: Scene) -> Scene:
    """Return the scene with its cameras turned and moved a little."""
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(0.01), -np.sin(0.01), 0], [np.sin(0.01), np.cos(0.01), 0], [0, 0, 1]]
    turn[:3, 3] = 0.01, 0.02, -0.01
    train, test = (
        [type(view.camera)(view.camera.K, turn @ view.camera.cam_from_world, 32, 32) for view in views]
        for views in (scene.train, scene.test)
    )
    return scene.with_cameras(train, test, 0.4)


def test_later_steps_see_the_adjusted_cameras(scene: Scene, tmp_path: Path) -> None:
    adjusted = moved(scene)
    write_cameras(tmp_path, adjusted)
    again = load_again(tmp_path / "spheres", tmp_path, make_config())
    assert again.camera_shift == 0.4
    for one, other in zip([*adjusted.train, *adjusted.test], [*again.train, *again.test], strict=True):
        assert one.name == other.name
        assert np.allclose(one.camera.cam_from_world, other.camera.cam_from_world, atol=1e-12)


def test_without_the_file_cameras_are_the_captures(scene: Scene, tmp_path: Path) -> None:
    assert with_known_cameras(tmp_path, scene) is scene


@pytest.mark.parametrize("damage", ["names", "shape", "nan", "text"])
def test_a_damaged_file_is_refused(scene: Scene, tmp_path: Path, damage: str) -> None:
    write_cameras(tmp_path, moved(scene))
    path = tmp_path / "adjusted_cameras.json"
    table = json.loads(path.read_text())
    first = next(iter(table["train"]))
    if damage == "names":
        table["train"]["other"] = table["train"].pop(first)
    elif damage == "shape":
        table["train"][first] = [[1, 2, 3]]
    elif damage == "nan":
        table["train"][first][0][3] = float("nan")
    path.write_text("{" if damage == "text" else json.dumps(table))
    with pytest.raises(MgsrError, match=r"adjusted_cameras\.json: expected a pose for each photograph of spheres"):
        with_known_cameras(tmp_path, scene)
