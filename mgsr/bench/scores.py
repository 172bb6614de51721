"""The scores of a finished run under one set of names, from its report or from an independent evaluator."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from mgsr.bench.running import REPORT, BrokenCell
from mgsr.report.data import ReportData

KEPT = "evaluate.json"

# Our name: the report's section and name, the evaluator's name, and the factor of both.
NAMES: dict[str, tuple[str, str, str, float]] = {
    "psnr": ("", "psnr_test", "psnr", 1),
    "psnr_object": ("", "psnr_fg_test", "psnr_fg", 1),
    "ssim": ("", "ssim_test", "ssim", 1),
    "chamfer": ("gt", "chamfer", "chamfer", 1000),
    "f_score": ("gt", "f_005", "F@0.005", 1),
    "normal_consistency": ("gt", "normal_consistency", "normal_consistency", 100),
    "normal_error": ("gt", "normal_error", "normal_mae_deg", 1),
    "split_psnr": ("split", "split_psnr", "split_psnr", 1),
    "split_gain": ("split", "split_gain", "split_gain", 1),
}


def report_scores(report: dict[str, Any]) -> dict[str, float | None]:
    """Return the program's own scores: `gt`, `split` and the test views of a report's JSON object."""
    found = {}
    for name, (section, key, _, factor) in NAMES.items():
        value = ((report.get(section) or {}) if section else report).get(key)
        found[name] = None if value is None else factor * value
    return found


def evaluator_scores(evaluator: Path, scene: Path, folder: Path) -> dict[str, float | None]:
    """Run an evaluator on a finished run, and return its scores.

    It is a script that is called as `evaluate.py SCENE --mesh MESH --renders FOLDER` and ends with a line of JSON. The
    scores are kept beside the run.

    Raises BrokenCell where it fails.
    """
    kept = folder / KEPT
    if not kept.is_file():
        kept.write_text(_evaluate(evaluator, scene, folder))
    try:
        values = json.loads(kept.read_text())
    except ValueError as error:
        kept.unlink()
        raise BrokenCell(f"{evaluator.name}: the last line must be JSON, but it is not ({error})") from error
    return {
        name: None if values.get(key) is None else factor * values[key] for name, (_, _, key, factor) in NAMES.items()
    }


def _evaluate(evaluator: Path, scene: Path, folder: Path) -> str:
    command = [sys.executable, str(evaluator), str(scene), "--mesh", str(folder / "mesh.ply")]
    command += ["--renders", str(folder / "renders" / "test")]
    asked = subprocess.run(command, capture_output=True, text=True)
    if asked.returncode != 0:
        said = asked.stderr.strip().splitlines()
        raise BrokenCell(
            f"{evaluator.name}: exit code {asked.returncode}: {said[-1] if said else 'it printed nothing'}"
        )
    return (asked.stdout.strip().splitlines() or [""])[-1]


def read_report(folder: Path) -> ReportData:
    """Read report.json of a finished run."""
    return ReportData.from_json(json.loads((folder / REPORT).read_text(encoding="utf-8")))
