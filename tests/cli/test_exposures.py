"""A capture whose photographs differ in exposure, from the command to the results."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from mgsr.cli.main import app
from program.worker import app as worker_app
from tests.cli.spheres import write_spheres
from tests.cli.test_run import SHORT, UNLIT
from tests.data.test_exposure import to_linear, to_srgb

pytestmark = pytest.mark.usefixtures("quick_report")

STAGES = ("surfel_iterations", "gaussian_iterations", "mutual.iterations")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide a capture of spheres in which photographs have as little as 40 % of the light."""
    folder = write_spheres(tmp_path_factory.mktemp("capture") / "spheres", size=48, train=24, test=4)
    (folder / "mesh_gt.ply").unlink()
    draw = np.random.default_rng(2)
    for path in sorted(folder.glob("*/*.png")):
        pixels = np.array(Image.open(path))
        light = to_linear(pixels[..., :3] / 255) * 2 ** draw.uniform(-1.3, 0)
        pixels[..., :3] = np.rint(255 * to_srgb(np.clip(light, 0, 1)))
        Image.fromarray(pixels).save(path)
    return folder


def run(scene: Path, out: Path, *more: str) -> dict[str, Any]:
    result = CliRunner().invoke(
        worker_app, ["run", str(scene), "-o", str(out), *SHORT, *UNLIT, "--set", "exposure=auto", *more]
    )
    assert result.exit_code == 0, result.output
    report: dict[str, Any] = json.loads((out / "report.json").read_text())
    return report


@pytest.fixture(scope="module")
def done(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "evened"
    run(scene, out)
    return out


def test_they_are_brought_to_one_and_the_report_says_so(scene: Path, done: Path, tmp_path: Path) -> None:
    report = json.loads((done / "report.json").read_text())
    factors = json.loads((done / "exposures.json").read_text())
    for split in ("train", "test"):
        assert list(factors[split]) == report["input"][f"{split}_views"]
    reported = next(each for each in report["decisions"] if each["what"] == "Exposures")
    assert "by a factor of up to" in reported["choice"] and "exposures differ" in (done / "log.txt").read_text()
    kept = run(scene, tmp_path / "kept", "--set", "exposure=keep")
    assert not (tmp_path / "kept" / "exposures.json").exists() and "exposures" not in kept["input"]
    assert report["psnr_fg_test"] > kept["psnr_fg_test"] + 1


def test_single_steps_see_what_the_run_saw(scene: Path, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    report = json.loads((out / "report.json").read_text())
    scored = CliRunner().invoke(app, ["evaluate", str(scene), "-o", str(out)])
    assert scored.exit_code == 0, scored.output
    assert json.loads(scored.output)["psnr_test"] == pytest.approx(report["psnr_test"], abs=0.02)
    (out / "exposures.json").write_text('{"train": {"r_0": [1, 2]}}')
    refused = CliRunner().invoke(app, ["mesh", str(scene), "-o", str(out), "--preset", "draft"])
    assert refused.exit_code != 0 and "exposures.json: expected three factors per photograph" in refused.output


@pytest.mark.slow
def test_a_later_run_without_leaves_no_factors(done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    shutil.copy(done / "exposures.json", out)
    short = ["--preset", "draft", *(w for name in STAGES for w in ("--set", f"{name}=5"))]
    result = CliRunner().invoke(app, ["train", str(write_spheres(tmp_path / "even")), "-o", str(out), *short])
    assert result.exit_code == 0, result.output
    assert (out / "splats_2d.ply").is_file() and not (out / "exposures.json").exists()
