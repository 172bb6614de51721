"""Adjusted cameras in a run: used, reported, stored and read again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsr.config import make_config
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import MgsrError
from mgsr.pipeline import preprocess
from mgsr.pipeline.preprocess import load_again
from mgsr.pipeline.result_files import with_known_cameras, write_cameras
from mgsr.pipeline.run_metadata import scene_facts
from mgsr.pipeline.steps import StepClock, Steps
from mgsr.start.bundle_adjustment import AdjustedCameras
from mgsr.start.points import StartingPoints, StartSource
from mgsr.start.scene_depths import DepthMaps
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
    with pytest.raises(MgsrError, match=r"adjusted_cameras\.json: expected a pose per photograph of spheres"):
        with_known_cameras(tmp_path, scene)


class _Run:
    """A preprocessing without masks, in which neither depths nor points are searched for."""

    def __init__(self, scene: Scene, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        draw = np.random.default_rng(0)
        views = [replace(view, alpha=None, image=draw.integers(0, 256, (32, 32, 3), np.uint8)) for view in scene.train]
        self.scene, self.out, self.said = replace(scene, train=views), out, [""]
        self.depths = DepthMaps([view.camera for view in views], [], [])
        self.points = StartingPoints(np.zeros((1, 3)), np.zeros((1, 3), np.uint8), StartSource.STEREO)
        self.used: list[DepthMaps] = []
        monkeypatch.setattr(preprocess, "scene_depths", lambda *given: self.depths)
        monkeypatch.setattr(preprocess, "starting_points", self._start)

    def _start(self, *given: Any) -> StartingPoints:
        self.used.append(given[-1])
        return self.points

    def __call__(self, *settings: str) -> Scene:
        steps = Steps(StepClock(), lambda event: self.said.append(event.text), lambda: False)
        config = make_config(overrides=["object=off", "exposure=keep", *settings])
        return preprocess.preprocess(self.scene, config, self.out, steps)[0]


def test_a_run_uses_the_adjusted_cameras(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = moved(scene)
    train, test = ([view.camera for view in views] for views in (other.train, other.test))
    monkeypatch.setattr(preprocess, "adjust_cameras", lambda *given: AdjustedCameras(train, test, 0.4, 0.1))
    run = _Run(scene, tmp_path, monkeypatch)
    found = run()
    assert [view.camera for view in (*found.train, *found.test)] == [*train, *test]
    assert all(np.allclose(a.cam_from_world, b.cam_from_world) for a, b in zip(run.used[0].cameras, train, strict=True))
    assert "the cameras were adjusted by 0.40 pixels in the median" in " ".join(run.said)
    assert scene_facts(found).camera_shift == 0.4
    again = with_known_cameras(tmp_path, run.scene)
    assert np.allclose(again.train[0].camera.cam_from_world, train[0].cam_from_world)


@pytest.mark.parametrize("setting", ["adjust_cameras=off", "adjust_cameras=on"])
def test_otherwise_cameras_stay(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, setting: str) -> None:
    def adjust(*given: Any) -> None:
        assert setting == "adjust_cameras=on"

    monkeypatch.setattr(preprocess, "adjust_cameras", adjust)
    write_cameras(tmp_path, moved(scene))
    run = _Run(scene, tmp_path, monkeypatch)
    found = run(setting)
    assert [view.camera for view in found.train] == [view.camera for view in scene.train]
    assert found.camera_shift is None and not (tmp_path / "adjusted_cameras.json").exists()
