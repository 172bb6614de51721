"""report.json holds what it must, and reads back as it was."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mgsr.report.data import ReportData
from tests.report.samples import sample_report

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


def test_further_entries_stand_at_the_top_level_and_come_back() -> None:
    data = sample_report()
    report = data.to_json()
    assert report["input"] == data.other["input"]
    assert ReportData.from_json(json.loads(json.dumps(report))) == data


def test_infinite_and_missing_numbers_are_null() -> None:
    data = replace(sample_report(), psnr_test=float("inf"), ssim_test=float("nan"), gt=None)
    report = json.loads(json.dumps(data.to_json(), allow_nan=False))
    assert report["psnr_test"] is None and report["ssim_test"] is None and report["gt"] is None


def test_a_missing_field_is_named() -> None:
    report = sample_report().to_json()
    del report["curve"]
    with pytest.raises(KeyError, match="curve"):
        ReportData.from_json(report)
