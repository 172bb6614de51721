"""The results of a matrix: a row for each cell, and the curve within each run, as CSV."""

from __future__ import annotations

import csv
import json
import os
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mgsr.bench.cells import Cell
from mgsr.bench.csv_rows import read_csv, write_csv
from mgsr.bench.running import MEASURED
from mgsr.report.data import ReportData

RUNS, CURVES = "runs.csv", "curves.csv"
DONE = "done"
KEY = ("scene", "variant", "method", "preset", "device", "seed")
MIB = 2**20


@dataclass(frozen=True)
class Row:
    """One cell of the matrix; a field is None if a run has no such figure.

    state: done, or the reason why the cell is broken.
    seconds: of the whole run; start, train and mesh are parts of it.
    psnr, ssim: of test views on white; psnr_object: on the object's pixels.
    chamfer: in thousandths of the object's radius.
    f_score: at 0.5% of that radius.
    normal_consistency: times 100.
    normal_error: in degrees.
    split_gain: the dB by which transmitted light is nearer to the object's matte look than the photograph.

    model_mib: the size of the splats' files.
    memory_mib: the most memory that the run held.
    others: the number of processors that other programs kept busy meanwhile.
    scored_by: report, or the evaluator's name.
    command: the command that repeats this run.
    """

    scene: str
    variant: str
    method: str
    preset: str
    device: str
    seed: int
    state: str = DONE
    seconds: float | None = None
    start_seconds: float | None = None
    train_seconds: float | None = None
    mesh_seconds: float | None = None
    psnr: float | None = None
    psnr_object: float | None = None
    ssim: float | None = None
    chamfer: float | None = None
    f_score: float | None = None
    normal_consistency: float | None = None
    normal_error: float | None = None
    split_psnr: float | None = None
    split_gain: float | None = None
    surfels: int | None = None
    gaussians: int | None = None
    faces: int | None = None
    model_mib: float | None = None
    memory_mib: float | None = None
    others: float | None = None
    scored_by: str = ""
    commit: str = ""
    machine: str = ""
    versions: str = ""
    command: str = ""
    note: str = ""

    @property
    def key(self) -> tuple[str | int, ...]:
        """Return what identifies the cell of this row."""
        return tuple(getattr(self, name) for name in KEY)

    @property
    def splats(self) -> int | None:
        """Return the number of Gaussians of both branches."""
        return None if self.surfels is None or self.gaussians is None else self.surfels + self.gaussians


@dataclass(frozen=True)
class Curve:
    """The curve within the run of one cell, by its key; points: (seconds of training, PSNR in dB)."""

    key: tuple[str | int, ...]
    points: tuple[tuple[float, float], ...]


def finished_row(
    cell: Cell, folder: Path, report: ReportData, scores: dict[str, float | None], scored_by: str, commit: str
) -> Row:
    """Build the row of a run that ended well."""
    seconds, splats = report.seconds, report.gaussians
    kernels = "unknown" if report.machine is None else report.machine.kernels
    measured = json.loads((folder / MEASURED).read_text())
    figures: dict[str, Any] = {f"{step}_seconds": seconds.get(step) for step in ("start", "train", "mesh")}
    figures |= {name: splats.get(name, 0) for name in ("surfels", "gaussians")} | scores
    return Row(
        **_identity(cell),
        **figures,
        seconds=seconds["total"],
        faces=None if report.mesh is None else report.mesh.faces,
        model_mib=sum(path.stat().st_size for path in folder.glob("splats_*.ply")) / MIB,
        memory_mib=report.peak_memory_mib,
        others=measured["others"],
        scored_by=scored_by,
        commit=commit,
        machine=f"{measured['processor']}, {kernels} kernels",
        versions=" ".join(f"{name} {version}" for name, version in report.versions.items()),
        command=told_command(cell.arguments(folder)),
    )


def told_command(words: Sequence[str]) -> str:
    """Join the arguments of `mgsr` for publication, with absolute paths relative to the current folder."""
    return shlex.join(["mgsr", *(os.path.relpath(word) if os.path.isabs(word) else word for word in words)])


def broken_row(cell: Cell, reason: str, commit: str) -> Row:
    """Build the row of a run without results."""
    return Row(**_identity(cell), state=f"broken: {reason}", commit=commit)


def run_curve(cell: Cell, report: ReportData) -> Curve:
    """Build the curve of a run: the PSNR of a few test views while it trained; no point where it had none."""
    points = ((row.seconds, row.psnr) for row in report.curve if row.psnr is not None)
    return Curve(tuple(_identity(cell).values()), tuple(points))


def _identity(cell: Cell) -> dict[str, Any]:
    values = (cell.scene.name, cell.variant.name, cell.method, cell.preset, cell.device, cell.seed)
    return dict(zip(KEY, values, strict=True))


def keep_rows(old: Iterable[Row], new: Iterable[Row]) -> list[Row]:
    """Merge old and new rows, sorted; a new row replaces the old one of its cell, unless it is broken.

    A replaced plain run is kept while variants or other methods of its scene, preset and commit exist, because these
    can be compared only with it.
    """
    kept: dict[tuple[str | int, ...], Row] = {}
    behind: dict[tuple[str | int, ...], Row] = {}
    old = list(old)
    known = {row.key for row in old}
    for row in (*(row for row in new if row.state == DONE or row.key not in known), *old):
        if kept.setdefault(row.key, row).commit != row.commit:
            behind.setdefault((*row.key, row.commit), row)
    others = {_circumstances(row) for row in kept.values() if not _is_plain(row)}
    needed = [row for row in behind.values() if _is_plain(row) and _circumstances(row) in others]
    return sorted([*kept.values(), *needed], key=lambda row: row.key)


def _is_plain(row: Row) -> bool:
    return not row.variant and row.method == "mgsr"


def _circumstances(row: Row) -> tuple[str, str, str]:
    """Return the circumstances that runs must share to be compared."""
    return row.scene, row.preset, row.commit


def latest(rows: Iterable[Row]) -> list[Row]:
    """Return those rows of `keep_rows` that have no newer row of their cell."""
    found: dict[tuple[str | int, ...], Row] = {}
    for row in rows:
        found.setdefault(row.key, row)
    return list(found.values())


def keep_curves(old: Iterable[Curve], new: Iterable[Curve]) -> list[Curve]:
    """Merge old and new curves, sorted; a new curve replaces the old one of its cell."""
    return sorted({curve.key: curve for curve in (*old, *new)}.values(), key=lambda curve: curve.key)


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows, with six digits of each figure, in the order of the fields."""
    write_csv(path, Row, rows, digits=6)


def read_rows(path: Path) -> list[Row]:
    """Read what `write_rows` wrote; no rows where there is no file."""
    return read_csv(path, Row)


def write_curves(path: Path, curves: Sequence[Curve]) -> None:
    """Write a line for each point of the curves: the cell's key, seconds, PSNR."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((*KEY, "seconds", "psnr"))
        for curve in curves:
            writer.writerows((*curve.key, f"{x:.1f}", f"{y:.2f}") for x, y in curve.points)


def read_curves(path: Path) -> list[Curve]:
    """Read what `write_curves` wrote; no curves where there is no file."""
    if not path.is_file():
        return []
    points: dict[tuple[str | int, ...], list[tuple[float, float]]] = {}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = (*(row[name] for name in KEY[:-1]), int(row["seed"]))
            points.setdefault(key, []).append((float(row["seconds"]), float(row["psnr"])))
    return [Curve(key, tuple(found)) for key, found in points.items()]
