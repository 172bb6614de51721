"""The rasterizers' benchmark: rows are printed and written as they come, and a mode that fails leaves the others."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks import rasterizers

CPU = torch.device("cpu")


def failing() -> list[torch.Tensor]:
    raise RuntimeError("no kernel image\nand more")


def test_a_mode_that_fails_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        rasterizers,
        "gsplat_modes",
        lambda scene: {"gsplat 3d": rasterizers.our_modes(scene)["3d"], "gsplat 2d": failing},
    )
    rows, failed = rasterizers.measure("1k/32", 2, CPU)
    assert [row.mode for row in rows] == ["3d", "2d", "dual", "gsplat 3d"]
    assert failed == {"gsplat 2d": "RuntimeError: no kernel image"}
    assert rasterizers.measure("1k/32", 1, CPU, beside=False)[1] == {}
    ratio = {
        row.mode: line.split("|")[7].strip() for row, line in zip(rows, rasterizers.table_lines(rows), strict=True)
    }
    assert float(ratio["3d"]) == pytest.approx(rows[0].both / rows[3].both, abs=0.006)
    assert ratio["2d"] == ratio["dual"] == ""


def test_rows_come_size_by_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Check that what was measured before the run was cut off is written."""
    measure, seen = rasterizers.measure, list[str]()

    def cut_off(size: str, *arguments: Any, **more: Any) -> tuple[list[rasterizers.Row], dict[str, str]]:
        if size == "2k/32":
            seen.extend([capsys.readouterr().out, (tmp_path / "rows.jsonl").read_text()])
            raise KeyboardInterrupt
        return measure(size, *arguments, **more)

    monkeypatch.setattr(rasterizers, "measure", cut_off)
    words = ["--device", "cpu", "--runs", "1", "--sizes", "1k/32", "2k/32", "--json", str(tmp_path / "rows.jsonl")]
    monkeypatch.setattr(sys, "argv", ["rasterizers.py", *words])
    with pytest.raises(KeyboardInterrupt):
        rasterizers.main()
    printed, written = seen
    assert printed.count("| 1k/32 |") == 3
    rows = [json.loads(line) for line in written.splitlines()]
    assert [(row["step"], row["mode"], row["memory"]) for row in rows] == [
        ("benchmark", mode, None) for mode in ("3d", "2d", "dual")
    ]


def test_the_size_of_the_targets_comes_first() -> None:
    assert rasterizers.SIZES[0] == "100k/800" and rasterizers.parse("100k/800") == (100_000, (800, 800))
