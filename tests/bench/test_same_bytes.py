"""The comparison of two folders of results, on folders whose differences are known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.same_bytes import compare_results

CONTENT = {
    "seconds": {"total": 3.0},
    "psnr_test": 30.0,
    "curve": [{"seconds": 1.0, "psnr": 20.0}],
    "settings": {"seed": 0, "train": {"tv": 1}},
}


def results(folder: Path, mesh: bytes = b"mesh", **changes: object) -> Path:
    """Make a folder of results with a mesh, a log that differs from folder to folder, and a report."""
    (folder / "renders").mkdir(parents=True)
    (folder / "mesh.ply").write_bytes(mesh)
    (folder / "renders/0.png").write_bytes(b"picture")
    (folder / "log.txt").write_text(folder.name)
    (folder / "report.json").write_text(json.dumps({**CONTENT, **changes}))
    return folder


def test_times_and_logs_do_not_count(tmp_path: Path) -> None:
    curve = [{"seconds": 9.0, "psnr": 20.0}]
    before, after = results(tmp_path / "a"), results(tmp_path / "b", seconds={"total": 4.0}, curve=curve)
    found = compare_results(before, after)
    assert (found.equal, found.differences, found.new_settings) == (3, (), ())
    assert found.text == "3 files are equal"


def test_every_difference_is_named(tmp_path: Path) -> None:
    curve = [{"seconds": 9.0, "psnr": 21.0}]
    before = results(tmp_path / "a")
    after = results(tmp_path / "b", b"another", psnr_test=31.0, curve=curve, settings={"seed": 1, "train": {}})
    (after / "mesh.obj").write_bytes(b"")
    found = compare_results(before, after)
    differing = ("mesh.ply", "report.json: curve.0.psnr", "report.json: psnr_test", "report.json: settings.seed")
    assert found.differences == ("mesh.obj (one side alone)", *differing)
    assert found.new_settings == ("settings.train.tv (one side alone)",)
    assert found.equal == 1


def test_an_unfinished_run_is_refused(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    with pytest.raises(ValueError, match=r"expected the results of a finished run, found no report\.json"):
        compare_results(results(tmp_path / "a"), tmp_path / "b")
