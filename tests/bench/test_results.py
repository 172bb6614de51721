"""Rows and curves as files, and how new ones meet old ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mgsr.bench.results import (
    Curve,
    Row,
    keep_curves,
    keep_rows,
    latest,
    read_curves,
    read_rows,
    told_command,
    write_curves,
    write_rows,
)
from mgsr.bench.table import results_page
from tests.bench.samples import sample_rows


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    rows = [*sample_rows(), Row("spot", 'a=1, "b"', "mgsr", "high", "cuda", 3, state="broken: it, said\nno")]
    write_rows(tmp_path / "runs.csv", rows)
    assert read_rows(tmp_path / "runs.csv") == rows
    assert read_rows(tmp_path / "none.csv") == []


def test_curves_come_back_as_they_were(tmp_path: Path) -> None:
    curves = [Curve(row.key, ((1.5, 20.25), (9.0, 30.0))) for row in sample_rows()]
    write_curves(tmp_path / "curves.csv", curves)
    assert read_curves(tmp_path / "curves.csv") == curves


def test_a_new_row_takes_the_place_of_its_old_one_alone() -> None:
    old = sample_rows()
    new = replace(old[1], psnr=1.0)
    kept = {row.key: row for row in keep_rows(old, [new])}
    assert kept[new.key] == new and len(kept) == len(old)
    assert all(kept[row.key] == row for row in old if row.key != new.key)


def test_a_plain_row_stays_behind_a_newer_one_for_the_variants_of_its_commit() -> None:
    old = sample_rows()
    (plain,) = (
        row
        for row in old
        if row.scene == "apple" and (row.method, row.preset) == ("mgsr", "standard") and not row.variant
    )
    new = replace(plain, psnr=1.0, commit="def")
    kept = keep_rows(old, [new])
    assert [row for row in kept if row.key == new.key] == [new, plain]
    assert [row for row in latest(kept) if row.key == new.key] == [new]
    assert keep_rows(kept, [new]) == kept


def test_an_older_row_goes_with_the_last_variant_of_its_commit() -> None:
    old = [row for row in sample_rows() if row.scene == "apple"]
    new = [replace(row, commit="def") for row in old]
    assert keep_rows(keep_rows(old, new[:-1]), new) == keep_rows([], new)


def test_a_broken_row_takes_no_figures_away() -> None:
    old = sample_rows()
    broken = replace(old[0], state="broken: no memory", psnr=None)
    assert keep_rows(old, [broken]) == keep_rows(old, [])
    other = replace(broken, scene="other")
    assert other in keep_rows(old, [other])


def test_a_new_curve_takes_the_place_of_its_old_one() -> None:
    key = sample_rows()[0].key
    assert keep_curves([Curve(key, ((1.0, 2.0),))], [Curve(key, ((3.0, 4.0),))]) == [Curve(key, ((3.0, 4.0),))]


def test_what_holds_for_all_rows_is_said_once_and_what_does_not_names_its_rows() -> None:
    rows = sample_rows()
    rows[0] = replace(rows[0], machine="a small machine")
    page = results_page(rows, "mgsr bench scenes")
    assert page.count(rows[0].versions) == 1
    assert f"Machine: a small machine ({rows[0].scene} {rows[0].method} {rows[0].preset})" in page
    assert len([line for line in page.splitlines() if line.startswith("| ")]) == len(rows) + 2


def test_commands_are_told_without_a_machines_own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    words = ["run", str(tmp_path / "a scene"), "-o", "out", "--set", "masks=off"]
    assert told_command(words) == "mgsr run '../a scene' -o out --set masks=off"
