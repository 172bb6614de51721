"""report.json holds what it must, and reads back as it was."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mgsr.report.data import BudgetFacts, FlashFacts, MeshStepRun, ReportData, Selection
from tests.optional import present
from tests.report.samples import bare_report, sample_report

REQUIRED = {
    *("scene", "preset", "method", "device", "seed", "versions", "seconds", "iterations", "gaussians"),
    *("psnr_test", "ssim_test", "curve", "mesh", "gt", "peak_memory_mib", "command", "decisions"),
}


def test_json_has_every_required_field() -> None:
    report = json.loads(json.dumps(sample_report().to_json()))
    assert not REQUIRED - set(report)
    assert {"seconds", "stage", "iteration", "psnr", "surfels", "gaussians"} <= set(report["curve"][0])
    assert {"vertices", "faces", "components", "boundary_edges"} <= set(report["mesh"])
    assert "total" in report["seconds"]
    assert all({"iterations", "stopped"} <= set(stage) for stage in report["iterations"].values())


def test_a_report_comes_back_as_it_was() -> None:
    sample = sample_report()
    whole = replace(
        sample,
        input=replace(present(sample.input), notes=["a note"], flash=FlashFacts(0.1, -0.2), shown=0.9),
        light="flash",
        start_kept=False,
        mesh_steps={"remove_contradicted": MeshStepRun(1.5, 900, {"removed_area": 0.02})},
        reflection=Selection("shared", {"off": 30.0, "shared": 30.6}),
        sh_degree=Selection(None, {}),
        time_budget=BudgetFacts(120.0, 117.2, 0.4, "of draft", 0.5, False, {"train": 60.0}, {"train": 64.0}),
        views={"r_0": {"psnr": 36.8}},
    )
    for data in (sample, whole, bare_report()):
        assert ReportData.from_json(json.loads(json.dumps(data.to_json()))) == data


def test_what_a_run_lacks_is_not_written_and_what_has_no_field_is_not_read() -> None:
    written = sample_report().to_json()
    assert {"input", "settings", "machine", "psnr_fg_test", "split"} <= set(written)
    assert not {"light", "time_budget", "views"} & set(written)
    assert "notes" not in written["input"] and written["input"]["starting_points"] == {"source": "hull", "count": 9000}
    assert not {"input", "split"} & set(bare_report().to_json())
    written["input"] |= {"weather": "fine"}
    assert ReportData.from_json(written | {"mood": "good"}) == sample_report()


def test_infinite_and_missing_numbers_are_null() -> None:
    data = replace(sample_report(), psnr_test=float("inf"), ssim_test=float("nan"), gt=None)
    report = json.loads(json.dumps(data.to_json(), allow_nan=False))
    assert report["psnr_test"] is None and report["ssim_test"] is None and report["gt"] is None


def test_a_missing_field_is_named() -> None:
    report = sample_report().to_json()
    del report["curve"]
    with pytest.raises(KeyError, match="curve"):
        ReportData.from_json(report)
