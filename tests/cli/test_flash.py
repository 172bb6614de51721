"""Photographs under a flash beside the lens, from their files to renders under even light."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import mgsr
from mgsr.cli.main import app
from mgsr.data.scene import Scene, Similarity, View
from mgsr.pipeline.scene_folder import write_scene_folder
from tests.cli.test_run import SHORT
from tests.shading.test_shape_from_shading import flash, photographs, rippled

pytestmark = pytest.mark.usefixtures("quick_report")

QUICK = [*SHORT, *("--set", "surfel_iterations=40", "--set", "gaussian_iterations=40", "--set", "mutual.iterations=30")]
ASIDE = (0.2, -0.3)
SCALE, OFFSET = 2.0, np.array([0.5, -1.0, 3.0])  # of the capture's frame


@pytest.fixture(scope="module")
def views() -> list[View]:
    return photographs(rippled(), flash, ASIDE, side=80)


@pytest.fixture(scope="module")
def capture(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture") / "ball"
    scene = Scene("ball", folder, "", views, [], None, Similarity(SCALE, OFFSET))
    write_scene_folder(folder, scene, 1.0)
    return folder


@pytest.fixture(scope="module")
def done(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "flash"
    result = CliRunner().invoke(app, ["run", str(capture), "-o", str(out), *QUICK, "--set", "max_light_residual=none"])
    assert result.exit_code == 0, result.output
    return out


def test_the_flash_is_found_and_told(done: Path) -> None:
    report = json.loads((done / "report.json").read_text())
    found = report["input"]["flash"]
    assert abs(found["right"] - SCALE * ASIDE[0]) < 0.1 and abs(found["down"] - SCALE * ASIDE[1]) < 0.1
    assert "Flash on the camera" in {decision["what"] for decision in report["decisions"]}
    assert (done / "flash.npz").is_file()


def test_even_light_has_the_paints_alone(done: Path, views: list[View]) -> None:
    """Check that the photograph darkens from the ball's middle to its rim, and the render under even light does not."""
    before, after = [], []
    for path in sorted((done / "renders" / "test").glob("*_even.png")):
        even = np.asarray(Image.open(path)).astype(float)
        view = next(view for view in views if f"{view.name}_even" == path.stem)
        photo, inside = view.image.astype(float), (view.alpha == 255) & (even[..., 3] > 250)
        red = inside & (photo[..., 0] > 1.2 * photo[..., 2]) & (photo.max(axis=-1) < 200)
        before.append(np.std(photo[red][:, 0]) / np.mean(photo[red][:, 0]))
        after.append(np.std(even[red][:, 0]) / np.mean(even[red][:, 0]))
    assert len(after) == 5 and np.mean(after) < 0.6 * np.mean(before)


def test_later_commands_light_as_the_run_did(capture: Path, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    shutil.rmtree(out / "renders")
    assert CliRunner().invoke(app, ["render", str(capture), "-o", str(out)]).exit_code == 0
    for path in sorted((done / "renders" / "test").glob("*.png")):
        again = np.asarray(Image.open(out / "renders" / "test" / path.name)).astype(int)
        if path.stem[-1].isdigit() or path.stem.endswith("_even"):
            assert np.abs(again - np.asarray(Image.open(path))).mean() < 0.5
    scores = CliRunner().invoke(app, ["evaluate", str(capture), "-o", str(out)])
    report = json.loads((done / "report.json").read_text())
    assert json.loads(scores.stdout)["psnr_test"] == pytest.approx(report["psnr_test"], abs=0.05)
    (out / "flash.npz").write_bytes(b"no archive")
    refused = CliRunner().invoke(app, ["render", str(capture), "-o", str(out)])
    assert refused.exit_code != 0 and "flash.npz: the file holds no flash" in refused.output


def test_python_lights_as_the_run_did(capture: Path, done: Path) -> None:
    scene, result = mgsr.load_scene(capture), mgsr.load_result(done)
    for view in scene.test[:2]:
        for camera in (view, scene.user_from_scene.camera_to_user(view.camera)):
            image = mgsr.render(result, camera)
            for color, ending in ((image.color, ""), (image.unlit, "_even")):
                picture = np.asarray(Image.open(done / "renders" / "test" / f"{view.name}{ending}.png")) / 255
                there = picture[..., 3] > 0.5
                assert color is not None and np.abs(color - picture[..., :3])[there].mean() < 0.5 / 255


@pytest.mark.slow
def test_without_it_splats_hold_what_photographs_show(capture: Path, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    arguments = ["train", str(capture), "-o", str(out), *QUICK, "--set", "flash=off"]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert not (out / "flash.npz").exists()  # none of the earlier run
