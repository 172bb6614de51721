"""Whole runs under a budget, on a small capture. Their clock is the time that the processor spent on this process, so
that what else a machine does at the time changes nothing; `tests/budget/test_budget.py` changes machines' speeds."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from mgsr.config import make_config
from mgsr.errors import Cancelled
from mgsr.pipeline.progress import Event
from mgsr.pipeline.run import run_scene
from mgsr.pipeline.run_context import RunControl
from mgsr.training.progress import Progress
from tests.cli.spheres import write_spheres

SMALL = ["surfels.max_start=1500", "gaussians.max_start=1500"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a scene without the truth, whose comparison takes longer than all the rest."""
    folder = write_spheres(tmp_path_factory.mktemp("capture") / "spheres")
    (folder / "mesh_gt.ply").unlink()
    return folder


@pytest.fixture(autouse=True)
def processor_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "perf_counter", time.process_time)


def run(scene: Path, out: Path, seconds: float, **options: Any) -> dict[str, Any]:
    """Run with a budget, and return the report."""
    config = make_config(overrides=[*SMALL, f"time_budget={seconds}"])
    report = run_scene(scene, out, config, "cpu", RunControl(started_at=time.perf_counter(), **options))
    found: dict[str, Any] = json.loads(report.read_text())
    return found


@pytest.mark.slow
def test_runs_end_near_their_budgets(scene: Path, tmp_path: Path) -> None:
    run(scene, tmp_path / "first", 1.0)  # loads what a process loads once
    least = run(scene, tmp_path / "least", 1.0)["time_budget"]
    assert least["too_small"]
    iterations = []
    for times in (1.5, 4.0):
        seconds = times * least["used"]
        report = run(scene, tmp_path / str(times), seconds)
        budget = report["time_budget"]
        assert 0.9 <= budget["used"] / seconds <= 1.05
        assert not budget["too_small"] and budget["image_scale"] == 1
        assert {"warmup_surfels", "warmup_gaussians", "mutual", "finish"} == set(report["iterations"])
        assert set(budget["planned"]) == {"before", "train", "mesh", "evaluate", "report"}
        iterations.append(report["iterations"]["mutual"]["iterations"])
    assert iterations[0] < iterations[1]


@pytest.mark.slow
def test_a_resumed_run_goes_on_with_its_seconds(scene: Path, tmp_path: Path) -> None:
    trained: list[Progress] = []

    def note(event: Event) -> None:
        if event.training is not None and event.training.stage == "warmup_surfels":
            trained.append(event.training)

    started_at = time.perf_counter()
    with pytest.raises(Cancelled, match="warmup_surfels"):
        run(scene, tmp_path / "out", 12.0, progress=note, should_stop=lambda: bool(trained))
    before, started_at = time.perf_counter() - started_at, time.perf_counter()
    report = run(scene, tmp_path / "out", 12.0, resume=True)
    here = time.perf_counter() - started_at
    assert report["time_budget"]["used"] > here + 0.5 * before
    assert report["iterations"]["warmup_surfels"]["iterations"] > trained[-1].iteration
