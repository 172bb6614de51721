"""The ablation rows are settings that runs take, and stand for the runs that they name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.evidence.ablations import FINDINGS
from mgsr.bench.ablations import NEED_ROWS, PAPER_CHOICES, PAPER_ROWS, AblationRow, named_rows
from mgsr.bench.cells import matrix, of_row, read_variants
from mgsr.bench.results import Row
from mgsr.config import ABLATIONS, Branches, Reflection, make_config


@pytest.mark.parametrize("row", [*PAPER_ROWS, *PAPER_CHOICES, *NEED_ROWS], ids=lambda row: row.name)
def test_each_row_is_a_run_and_changes_something(row: AblationRow) -> None:
    config, plain = make_config("standard", row.method, 0, row.overrides), make_config()
    assert (replace(config, method="mgsr") == plain) is (row.name == "E")


@pytest.mark.parametrize("name", list(ABLATIONS))
def test_each_row_has_the_settings_of_the_supplements_model(name: str) -> None:
    row = named_rows()[name]
    expected = make_config(overrides=[f"{key}={value}" for key, value in ABLATIONS[name].items()])
    assert replace(make_config("standard", row.method, 0, row.overrides), method="mgsr") == expected


def test_what_the_letters_mean() -> None:
    rows = named_rows()
    a, b, k, stop, n = (make_config("standard", rows[x].method, 0, rows[x].overrides).train for x in "ABKLN")
    assert (a.branches, a.gaussians.reflection) == (Branches.GAUSSIANS, Reflection.OWN)  # 3DGS with the split
    assert b.branches == Branches.SURFELS
    assert (k.paper.teaching, stop.paper.stop_rule, n.paper.tv) == ("one_way", "none", False)


def test_equal_rows_are_run_once() -> None:
    variants = read_variants(["plain", "ablations", "E", "I", "M", "B"])
    cells = matrix([Path("scene")], ["mgsr", "2dgs"], variants=variants)
    plain = [cell.method for cell in cells if not cell.variant.name]
    assert sorted(plain) == ["2dgs", "mgsr"]
    named = [cell.variant.name for cell in cells if cell.variant.name]
    assert named == ["A", "C", "D", "F", "G", "H", "J", "K", "L", "N"]


def test_a_row_keeps_its_method() -> None:
    assert {cell.method for cell in matrix([Path("scene")], ["3dgs"], variants=[of_row(named_rows()["K"])])} == {"mgsr"}


def test_findings_compare_known_rows_by_known_scores() -> None:
    scores = set(Row.__dataclass_fields__)
    assert all(row in named_rows() and set(names) <= scores for _, row, names in FINDINGS)
