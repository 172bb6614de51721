"""What the check makes of a training: its row, its splats, and whether it is another one's twin."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gpu_check import train
from benchmarks.gpu_check.results import Results
from benchmarks.packed_scenes import Packed, pack
from tests.training.ball import ball_points, ball_scene

SETTINGS = (
    "warmup.surfel_iterations=10",
    "warmup.gaussian_iterations=10",
    "mutual.iterations=10",
    "model_selection.iterations=0",
)


def facts(surfels: str = "a", gaussians: str = "b", reason: str = "iterations") -> dict[str, Any]:
    sha256 = {"splats_2d.ply": surfels, "splats_3d.ply": gaussians}
    return {"sha256": sha256, "stages": {"warmup_surfels": [9, 1.0, "converged"], "mutual": [10, 1.0, reason]}}


def test_twins(capsys: pytest.CaptureFixture[str]) -> None:
    train.compare(facts(), [facts("another"), facts()], "first")  # the last row is of this call
    assert capsys.readouterr().out == "result: the same bytes as first: splats_2d.ply, splats_3d.ply\n"


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ([facts(gaussians="c")], r"NOT the same bytes as first: splats_3d.ply$"),
        ([{**facts(), "sha256": {"splats_2d.ply": "a"}}], r"NOT the same bytes as first: splats_3d.ply$"),
        ([facts(reason="deadline")], "not compared, because a training stopped by its time limit"),
        ([], "first has no row"),
    ],
)
def test_no_twins(other: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(SystemExit, match=message):
        train.compare(facts(), other, "first")


def test_a_training_leaves_its_row_and_its_splats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pack(Packed(ball_scene(size=24, train=4, test=1), ball_points(100), {"flash.npz": b"x"}), tmp_path / "spot.npz")

    def run(name: str, *more: str) -> str:
        words = ["--results", str(tmp_path / "results"), "--work", str(tmp_path / "work"), "--device", "cpu"]
        words += ["--step", name, "--preset", "draft", "--deadline", "60", *more]
        words += [f"--set={setting}" for setting in SETTINGS]
        monkeypatch.setattr(sys, "argv", ["train", *words, str(tmp_path / "spot.npz")])
        train.main()
        return capsys.readouterr().out

    assert "result: its splats are in splats.zip, " in run("first", "--bring-home")
    assert "result: the same bytes as first: " in run("again", "--same-as", "first")
    results = Results(tmp_path / "results")
    assert results.rows("first")[0]["psnr"] == results.rows("again")[0]["psnr"]
    with zipfile.ZipFile(results.folder / "splats.zip") as archive:
        names = {"flash.npz", "splats_2d.ply", "splats_3d.ply", "training.json"}
        assert names <= {name.removeprefix("spot/") for name in archive.namelist()}


def test_splats_that_are_too_many_are_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "splats_2d.ply").write_bytes(b"many")
    train.bring_home(Results(tmp_path / "results", largest=10), "lego", tmp_path)
    assert "NOT in splats.zip" in capsys.readouterr().out
