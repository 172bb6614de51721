"""Estimates of seconds and memory, held against runs that were measured (benchmarks/results/runs.csv)."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest

from mgsr.budget import costs
from mgsr.budget.costs import textured_cost
from mgsr.budget.estimate import Estimate, Speed, estimate_run
from mgsr.config import PRESETS, Config, make_config
from mgsr.data.cost_factors import CostFactors
from mgsr.data.readers import load_scene
from mgsr.errors import ConfigError
from mgsr.pipeline import estimate
from mgsr.training.probe import Probe
from tests.cli.spheres import write_spheres

RUNS = Path(__file__).resolve().parents[2] / "benchmarks/results/runs.csv"
# Views, test views, and pixels a side of the measurement scenes.
SCENES = {name: (48, 8, 256) for name in ("bunny_flash", "spot_soft", "teapot_hdr", "wingnut_dark")}
SCENES["nefertiti_hdr_800"] = (100, 8, 800)


def measured() -> list[dict[str, str]]:
    """Return the whole runs of the method that is documented, on the CPU, without changed settings."""
    with RUNS.open() as file:
        rows = list(csv.DictReader(file))
    kind = {"method": "mgsr", "device": "cpu", "state": "done", "variant": ""}
    return [row for row in rows if row["scene"] in SCENES and kind.items() <= row.items()]


def cost_factors(row: dict[str, str]) -> CostFactors:
    views, tests, side = SCENES[row["scene"]]
    return CostFactors(views, tests, side * side, truth=True, flash=row["scene"] == "bunny_flash")


def estimated(row: dict[str, str]) -> Estimate:
    return estimate_run(row["preset"], cost_factors(row), make_config(row["preset"]), Speed(1.0, 1.0), {})


def test_there_are_runs_to_compare_with() -> None:
    assert {row["preset"] for row in measured()} == set(PRESETS) and len(measured()) > 10


@pytest.mark.parametrize("row", measured(), ids=lambda row: f"{row['scene']}-{row['preset']}-{row['seconds']}")
def test_memory_is_near_that_of_measured_runs(row: dict[str, str]) -> None:
    assert estimated(row).memory_mib == pytest.approx(float(row["memory_mib"]), rel=0.25)


def test_seconds_are_in_proportion_to_those_of_measured_runs() -> None:
    """Check that one speed explains the runs of a commit, which were made in one go on one machine.

    Training that converges early takes less than planned. The measured runs made no textured model.
    """
    ratios: dict[str, list[float]] = {}
    for row in measured():
        ratios.setdefault(row["commit"], []).append(
            (estimated(row).seconds - textured_cost(cost_factors(row))) / float(row["seconds"])
        )
    assert sum(len(found) for found in ratios.values() if len(found) > 2) > 15
    assert all(max(found) / min(found) < 1.95 for found in ratios.values())


def test_surfels_follow_the_pixels_that_show_the_object() -> None:
    config, usual = make_config(), CostFactors(48, 8, 256 * 256, truth=True)
    large = replace(usual, pixels=4 * usual.pixels)
    small_object = replace(large, surface_pixels=usual.pixels)
    assert costs.detail(usual, config) == 1 and costs.detail(small_object, config) < 1.1
    assert 3.5 < costs.detail(large, config) < 4.5 and costs.detail(replace(large, pixels=1e9), config) == 8
    assert costs.detail(large, make_config("draft")) < 1.1


def test_each_preset_of_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_spheres(tmp_path / "spheres", size=32, train=8, test=1)
    scene, seen = load_scene(folder), []

    def slow(factor: float) -> list[Estimate]:
        def probed(scene: object, start: object, config: Config, device: object) -> Probe:
            seen.append(config.train.mutual.iterations)
            times = {"warmup_surfels": 0.01 * factor, "warmup_gaussians": 0.01 * factor, "mutual": 0.02 * factor}
            return Probe(times, {"surfels": 1000, "gaussians": 1000})

        monkeypatch.setattr(estimate, "probe", probed)
        return estimate.estimate_presets(scene, make_config(overrides=["check=off"]), "cpu")

    once, twice = slow(1.0), slow(2.0)
    assert [each.preset for each in once] == list(PRESETS)
    assert once[0].seconds < once[1].seconds < once[2].seconds
    assert once[0].memory_mib < once[1].memory_mib < once[2].memory_mib
    for one, two in zip(once, twice, strict=True):
        assert two.steps["train"] == pytest.approx(2 * one.steps["train"], rel=0.02)
        assert one.seconds == pytest.approx(sum(one.steps.values()), abs=0.5)


def test_settings_of_the_caller_stay_at_each_preset(tmp_path: Path) -> None:
    folder = write_spheres(tmp_path / "spheres", size=32, train=8, test=1)
    few = [
        "mutual.iterations=2",
        "warmup.surfel_iterations=2",
        "warmup.gaussian_iterations=2",
        "model_selection.iterations=0",
    ]
    found = estimate.estimate_presets(folder, make_config(overrides=[*few, "surfels.max_start=500"]), "cpu")
    assert {each.steps["train"] < 5 for each in found} == {True}
    assert {"load", "check"} <= set(found[0].steps)
    with pytest.raises(ConfigError, match="device"):
        estimate.estimate_presets(folder, make_config(), "abacus")


def test_an_estimate_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = write_spheres(tmp_path / "spheres", size=32, train=8, test=1), tmp_path / "out"
    out.mkdir()
    reported: list[str] = []
    path = estimate.write_estimate(folder, out, make_config(), "cpu", lambda event: reported.append(event.text))
    from worker.publish import findings, headline

    assert path == out / "estimate.json"
    assert [each["preset"] for each in headline(out)["estimate"]] == list(PRESETS)
    assert {"code", "severity", "cure"} <= set((findings(out) or [{"code": 1, "severity": 1, "cure": 1}])[0])
    assert any(text.startswith("standard") and "GiB" in text for text in reported)
