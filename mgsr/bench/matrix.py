"""Runs of a matrix: its cells one after another, with the tables updated after each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from mgsr.bench.cells import Cell
from mgsr.bench.results import (
    CURVES,
    DONE,
    RUNS,
    Curve,
    Row,
    broken_row,
    finished_row,
    keep_curves,
    keep_rows,
    read_curves,
    read_rows,
    run_curve,
    write_curves,
    write_rows,
)
from mgsr.bench.running import BrokenCell, is_finished, made_at, run_cell
from mgsr.bench.scores import evaluator_scores, read_report, report_scores
from mgsr.bench.table import results_page

PAGE = "runs.md"


@dataclass(frozen=True)
class Bench:
    """The settings with which a matrix is run.

    out: a folder for each cell below it. commit: the program's; any_commit: take finished results of another one too.
    evaluator: a script that scores instead of the report. keep: the folders of tables that take the rows in, `out`
    itself among them. command: the command line.
    """

    out: Path
    commit: str
    command: str
    keep: tuple[Path, ...]
    evaluator: Path | None = None
    any_commit: bool = False


def run_matrix(
    cells: Iterable[Cell], bench: Bench, tell: Callable[[str], None], stop: Callable[[], bool]
) -> tuple[list[Row], list[Curve]]:
    """Run all cells, and return their rows and curves; a broken cell has its row too.

    The tables are written after each cell. Raises Stopped when `stop` says so.
    """
    rows: list[Row] = []
    curves: list[Curve] = []
    for cell in cells:
        row, curve = _one(cell, bench, tell, stop)
        tell(f"{cell.name}: {_summary(row)}")
        rows.append(row)
        curves += [curve] if curve is not None else []
        for folder in bench.keep:
            keep_tables(folder, rows, curves, bench.command)
    return rows, curves


def keep_tables(folder: Path, rows: Iterable[Row], curves: Iterable[Curve], command: str) -> None:
    """Merge the rows and curves into the tables of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = keep_rows(read_rows(folder / RUNS), rows)
    write_rows(folder / RUNS, kept)
    write_curves(folder / CURVES, keep_curves(read_curves(folder / CURVES), curves))
    (folder / PAGE).write_text(results_page(kept, command), encoding="utf-8")


def _one(cell: Cell, bench: Bench, tell: Callable[[str], None], stop: Callable[[], bool]) -> tuple[Row, Curve | None]:
    folder = bench.out / cell.name
    try:
        if not is_finished(cell, folder, None if bench.any_commit else bench.commit):
            tell(f"{cell.name}: running")
            run_cell(cell, folder, bench.commit, stop)
        return _results(cell, folder, bench)
    except BrokenCell as broken:
        return broken_row(cell, str(broken), bench.commit), None


def _results(cell: Cell, folder: Path, bench: Bench) -> tuple[Row, Curve]:
    report = read_report(folder)
    if bench.evaluator is None:
        scores, scored_by = report_scores(report.to_json()), "report"
    else:
        scores, scored_by = evaluator_scores(bench.evaluator, cell.scene, folder), bench.evaluator.name
    return finished_row(cell, folder, report, scores, scored_by, made_at(folder)), run_curve(cell, report)


def _summary(row: Row) -> str:
    if row.state != DONE:
        return row.state
    known = (("PSNR {:.2f} dB", row.psnr), ("Chamfer {:.2f}", row.chamfer), ("NC {:.2f}", row.normal_consistency))
    return ", ".join([f"{row.seconds:.0f} s", *(words.format(value) for words, value in known if value is not None)])
