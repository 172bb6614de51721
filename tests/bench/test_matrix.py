"""`mgsr bench` on a tiny capture: what is run, what is not run again, what breaks, and what the tables say."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from mgsr.bench.cells import Cell, Variant, matrix
from mgsr.bench.machine import program_commit
from mgsr.bench.running import Stopped, is_finished, run_cell
from mgsr.bench.scores import KEPT
from mgsr.cli.main import app
from mgsr.pipeline.stop_signals import INTERRUPTED
from tests.cli.spheres import write_spheres

SETTINGS = (
    "surfel_iterations=40",
    "mutual.iterations=20",
    "surfels.max_start=800",
    "poisson_depth=5",
    "max_environment_ratio=0",
)
TINY = Variant(" ".join(SETTINGS), SETTINGS)


class Matrix:
    """The scenes of a matrix.

    One has its truth, one is the same without, and one can't be read. All but the second are run at once.
    """

    def __init__(self, folder: Path) -> None:
        self.truth, self.bare, self.empty, self.out = (folder / name for name in ("truth", "bare", "empty", "out"))
        write_spheres(self.truth, size=32, train=8)
        shutil.copytree(self.truth, self.bare, ignore=shutil.ignore_patterns("mesh_gt.ply"))
        self.empty.mkdir()
        self.first = self.run(self.empty, self.truth)

    def run(self, *scenes: Path, more: tuple[str, ...] = (), out: Path | None = None) -> Result:
        words = ["bench", *map(str, scenes), "-o", str(out or self.out), "--methods", "2dgs", "--presets", "draft"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("sys.argv", ["program", "bench", "as", "typed"])
            return CliRunner().invoke(app, [*words, *(w for s in SETTINGS for w in ("--set", s)), *more])

    def rows(self, folder: Path | None = None) -> dict[str, dict[str, str]]:
        with open((folder or self.out) / "runs.csv", newline="") as file:
            return {row["scene"]: row for row in csv.DictReader(file)}

    def cell(self, scene: Path, variant: Variant = TINY) -> Cell:
        return Cell(scene, "2dgs", "draft", variant=variant)

    def folder(self, scene: Path) -> Path:
        return self.out / self.cell(scene).name

    def written(self, *scenes: Path) -> list[int]:
        return [(self.folder(scene) / "report.json").stat().st_mtime_ns for scene in scenes]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Matrix:
    return Matrix(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def with_bare(done: Matrix) -> Matrix:
    """Run the scene without its truth, too."""
    assert done.run(done.bare).exit_code == 0
    return done


def test_a_broken_cell_is_reported_and_the_rest_goes_on(done: Matrix) -> None:
    assert done.first.exit_code == 1
    rows = done.rows()
    assert rows["truth"]["state"] == "done"
    assert rows["empty"]["state"].startswith("broken: exit code 2: error: ")
    assert "the folder is empty" in rows["empty"]["state"] and "the folder is empty" in done.first.stdout
    assert "1 of 2 runs have results" in done.first.stdout


def test_a_row_says_what_the_report_says(done: Matrix) -> None:
    row, folder = done.rows()["truth"], done.folder(done.truth)
    report = json.loads((folder / "report.json").read_text())
    expected = {
        "seconds": report["seconds"]["total"],
        "mesh_seconds": report["seconds"]["mesh"],
        "psnr": report["psnr_test"],
        "chamfer": 1000 * report["gt"]["chamfer"],
        "normal_consistency": 100 * report["gt"]["normal_consistency"],
        "surfels": report["gaussians"]["surfels"],
        "gaussians": 0,
        "memory_mib": report["peak_memory_mib"],
        "model_mib": (folder / "splats_2d.ply").stat().st_size / 2**20,
    }
    assert {name: float(row[name]) for name in expected} == pytest.approx(expected, rel=1e-5)
    assert row["commit"] == program_commit() and "cores" in row["machine"] and "torch" in row["versions"]
    assert row["command"].startswith("mgsr run ") and "--set surfel_iterations=40" in row["command"]
    assert (row["scored_by"], row["split_gain"], row["variant"]) == ("report", "", TINY.name)


@pytest.mark.slow
def test_without_truth_there_is_no_chamfer_and_the_rest_is_there(with_bare: Matrix) -> None:
    row = with_bare.rows()["bare"]
    assert row["chamfer"] == row["normal_error"] == "" and float(row["psnr"]) > 10


def test_the_page_has_machine_versions_commit_and_command(done: Matrix) -> None:
    page, row = (done.out / "runs.md").read_text(), done.rows()["truth"]
    assert row["machine"] in page and row["versions"] in page and row["commit"] in page
    assert "`mgsr bench as typed`" in page
    # Of the report, as the row's six digits may round to a tie.
    report = json.loads((done.folder(done.truth) / "report.json").read_text())
    assert f"| {1000 * report['gt']['chamfer']:.2f} |" in page
    assert "Broken: empty" in page


def test_the_curve_is_the_reports(done: Matrix) -> None:
    report = json.loads((done.folder(done.truth) / "report.json").read_text())
    with open(done.out / "curves.csv", newline="") as file:
        points = [row for row in csv.DictReader(file) if row["scene"] == "truth"]
    assert [float(point["psnr"]) for point in points] == [round(row["psnr"], 2) for row in report["curve"]]


def test_the_cell_ran_in_a_process_of_its_own_and_the_load_was_watched(done: Matrix) -> None:
    assert "mesh.ply" in (done.folder(done.truth) / "console.txt").read_text()
    load = json.loads((done.folder(done.truth) / "machine.json").read_text())
    assert load["others"] is None or 0 <= load["others"] < 1000


def test_what_is_finished_is_not_run_again(done: Matrix) -> None:
    before, rows = done.written(done.truth), done.rows()
    again = done.run(done.truth)
    assert again.exit_code == 0 and ": running" not in again.stdout
    assert done.written(done.truth) == before
    assert done.rows() == rows


@pytest.mark.slow
def test_a_half_written_cell_is_run_again_and_no_other(with_bare: Matrix) -> None:
    before = with_bare.written(with_bare.truth)
    path = with_bare.folder(with_bare.bare) / "report.json"
    path.write_text(path.read_text()[:500])
    again = with_bare.run(with_bare.truth, with_bare.bare)
    assert again.stdout.count(": running") == 1
    assert json.loads(path.read_text())["scene"] == "bare" and with_bare.written(with_bare.truth) == before


def test_other_settings_commit_or_device_are_other_runs(done: Matrix) -> None:
    cell, folder, commit = done.cell(done.truth), done.folder(done.truth), program_commit()
    assert is_finished(cell, folder, commit)
    assert not is_finished(cell, folder, "0000000") and is_finished(cell, folder, None)
    assert not is_finished(done.cell(done.truth, Variant(TINY.name, (*SETTINGS, "tv=off"))), folder, commit)
    assert not is_finished(Cell(done.truth, "2dgs", "draft", "cuda", 0, TINY), folder, commit)
    assert not is_finished(Cell(done.truth, "2dgs", "draft", "cpu", 1, TINY), folder, commit)
    assert not is_finished(done.cell(done.empty), folder, commit)


def test_an_evaluator_takes_the_place_of_the_reports_scores(done: Matrix, tmp_path: Path) -> None:
    values = {"psnr": 31.5, "chamfer": 0.0021, "F@0.005": 0.75, "normal_consistency": 0.98, "normal_mae_deg": 6.5}
    evaluator = tmp_path / "judge.py"
    evaluator.write_text(f"print('loading')\nprint({json.dumps(json.dumps(values))})")
    done.run(done.truth, more=("--evaluate", str(evaluator), "--keep", str(tmp_path / "kept")))
    row = done.rows(tmp_path / "kept")["truth"]
    assert (row["psnr"], row["chamfer"], row["f_score"], row["ssim"]) == ("31.5", "2.1", "0.75", "")
    assert row["scored_by"] == "judge.py"


def test_an_evaluator_that_fails_breaks_the_cell_and_loses_no_run(done: Matrix, tmp_path: Path) -> None:
    evaluator, out = tmp_path / "judge.py", tmp_path / "out"
    evaluator.write_text("raise SystemExit('no truth here')")
    cell = out / done.cell(done.truth).name
    shutil.copytree(done.folder(done.truth), cell, ignore=shutil.ignore_patterns(KEPT))
    assert done.run(done.truth, more=("--evaluate", str(evaluator)), out=out).exit_code == 1
    assert done.rows(out)["truth"]["state"] == "broken: judge.py: exit code 1: no truth here"
    assert is_finished(done.cell(done.truth), cell, program_commit())


def test_a_stop_ends_the_run_that_goes_on(done: Matrix, tmp_path: Path) -> None:
    asked = iter([False, False, True])
    with pytest.raises(Stopped):
        run_cell(done.cell(done.truth), tmp_path / "cell", "abc", lambda: next(asked))
    assert not is_finished(done.cell(done.truth), tmp_path / "cell", "abc")


def test_ctrl_c_says_how_to_go_on(done: Matrix, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def stopped(*_: object) -> None:
        raise Stopped

    monkeypatch.setattr("mgsr.bench.matrix.run_cell", stopped)
    result = done.run(done.truth, out=tmp_path)
    assert result.exit_code == INTERRUPTED and "The same command continues" in result.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "nerf"], "mgsr, 2dgs, 3dgs"),
        (["--presets", "best"], "draft, standard, high"),
        (["--seeds", "1,x"], "got 'x'"),
        (["--variant", "Z"], "ablations"),
        (["--variant", "mask=off"], "masks"),
    ],
)
def test_a_matrix_that_no_run_would_take_is_refused_before_any_run(
    tmp_path: Path, words: list[str], message: str
) -> None:
    result = CliRunner().invoke(app, ["bench", str(tmp_path), "-o", str(tmp_path / "out"), *words])
    assert result.exit_code == 2 and message in result.stderr
    assert not (tmp_path / "out").exists()


def test_every_combination_once_and_scene_by_scene() -> None:
    scenes = [Path("a"), Path("b")]
    cells = matrix(scenes, ["mgsr", "2dgs"], ["draft", "high"], ["cpu"], [0, 1], [Variant(), Variant()])
    assert len(cells) == len(set(cells)) == len({cell.name for cell in cells}) == 16
    assert [cell.scene for cell in cells] == [scenes[0]] * 8 + [scenes[1]] * 8


def test_long_variants_get_short_folders_of_their_own() -> None:
    names = {Cell(Path("a"), variant=Variant("x" * 300 + tail)).name for tail in "ab"}
    assert len(names) == 2 and max(map(len, names)) < 150
