"""`mgsr check` and `mgsr estimate`, and the check as a step of a run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mgsr.cli.main import app
from mgsr.config import make_config
from mgsr.data.readers import load_scene
from mgsr.errors import SceneError
from mgsr.inspection.findings import Code, Finding, Inspection, Severity
from mgsr.pipeline import scene_check
from mgsr.pipeline.progress import Event
from mgsr.pipeline.scene_check import check_scene, without_contradictory
from mgsr.pipeline.steps import StepClock, Steps
from tests.cli.spheres import write_spheres


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_spheres(tmp_path_factory.mktemp("capture") / "spheres", size=48, train=10, test=2)


def wrong(*names: str) -> Inspection:
    finding = Finding(Code.CONTRADICTORY_POSE, Severity.ERROR, "wrong", 1.0, "photographs", "find them anew", names)
    return Inspection((finding,), (), 0.1)


def test_a_capture_is_checked(capture: Path) -> None:
    ran = CliRunner().invoke(app, ["check", str(capture)])
    assert (
        ran.exit_code == 0 and "12 photographs checked" in ran.stdout and "note: the photographs have 48" in ran.stdout
    )
    found = json.loads(CliRunner().invoke(app, ["check", str(capture), "--json"]).stdout)
    assert len(found["photographs"]) == 12 and {"name", "center", "residual"} <= set(found["photographs"][0])
    assert "test/r_0" in {photo["name"] for photo in found["photographs"]}
    strict = CliRunner().invoke(app, ["check", str(capture), "--set", "photos.wide=1"])
    assert "degrees wide" in strict.stdout and "degrees wide" not in ran.stdout


def test_errors_have_an_exit_code(capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mgsr.inspection.inspect.inspect_scene", lambda scene, options: wrong("r_1"))
    ran = CliRunner().invoke(app, ["check", str(capture)])
    assert ran.exit_code == 1 and "error: wrong (r_1); find them anew" in ran.stdout


@pytest.mark.parametrize(("flawed", "left"), [("keep", 10), ("drop", 8)])
def test_contradictory_photographs_are_left_out_where_that_is_asked_for(
    capture: Path, monkeypatch: pytest.MonkeyPatch, flawed: str, left: int
) -> None:
    found = wrong("r_1", "r_4", "test/r_1")
    monkeypatch.setattr(scene_check, "inspect_scene", lambda scene, progress, options: found)
    reported: list[Event] = []
    config = make_config(overrides=[f"flawed={flawed}"])
    checked = check_scene(load_scene(capture), config, Steps(StepClock(), reported.append, lambda: False))
    assert len(checked.scene.train) == left and len(checked.scene.test) == (2 if left == 10 else 1)
    assert [event.inspection for event in reported if event.inspection] == [checked.inspection]
    assert any("left out" in note for note in checked.scene.notes) == (flawed == "drop")


def test_a_check_can_be_left_out(capture: Path) -> None:
    steps = Steps(StepClock(), lambda event: None, lambda: False)
    scene = load_scene(capture)
    checked = check_scene(scene, make_config(overrides=["check=off"]), steps)
    assert checked.scene is scene and checked.inspection is None and not steps.clock.steps


def test_at_least_two_photographs_are_left(capture: Path) -> None:
    scene = load_scene(capture)
    with pytest.raises(SceneError, match=r"expected at least 2 training photographs .*, got 1;"):
        without_contradictory(scene, wrong(*(view.name for view in scene.train[1:])))


def test_an_estimate_is_told(capture: Path) -> None:
    few = ["--set", "surfels.max_start=300", "--set", "gaussians.max_start=300"]
    ran = CliRunner().invoke(app, ["estimate", str(capture), "--device", "cpu", *few])
    assert ran.exit_code == 0, ran.output
    assert [line.split()[0] for line in ran.stdout.splitlines()] == ["draft", "standard", "high"]
