"""Quality over time: both programs run in turns, what is finished is not run again, and the page compares both."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from benchmarks import quality_over_time
from benchmarks.evidence.quality_over_time import Program, QualityRow, quality_section, write_quality_plot
from mgsr.bench.csv_rows import read_csv

EVALUATOR = """import json, pathlib, sys
folder = pathlib.Path(sys.argv[sys.argv.index("--mesh") + 1]).parent
scores = {"psnr": 30.0 + json.loads((folder / "gain.json").read_text()), "chamfer": 0.002}
print(json.dumps(scores))
"""


def program(folder: Path, name: str, gain: float) -> str:
    """Write a program that notes its call and leaves what it gains over 30 dB in its results; return its path."""
    path = folder / name
    path.write_text(
        f'#!/bin/sh\necho "{name} $2 $6" >> {folder}/calls.txt\ntest "$1 $3 $5" = "run -o --time-budget" || exit 1\n'
        f'echo {gain} > "$4/gain.json"\n'
    )
    path.chmod(0o755)
    return str(path)


def row(program: Program, budget: float, psnr: float, chamfer: float) -> QualityRow:
    return QualityRow(
        "apple", budget, program, "0000001" if program is Program.BEFORE else "0000002", budget, psnr, chamfer
    )


def test_both_programs_run_in_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "apple").mkdir()
    (tmp_path / "evaluate.py").write_text(EVALUATOR)
    words = [str(tmp_path / "apple"), "-o", str(tmp_path / "rows.csv"), "--runs", str(tmp_path / "runs")]
    words += ["--before", f"0000001={program(tmp_path, 'old', 1)}", "--after", f"0000002={program(tmp_path, 'new', 2)}"]
    words += ["--budgets", "30", "15", "--evaluate", str(tmp_path / "evaluate.py")]
    monkeypatch.setattr("sys.argv", ["quality_over_time", *words])
    quality_over_time.main()
    quality_over_time.main()
    scene = tmp_path / "apple"
    calls = (tmp_path / "calls.txt").read_text().splitlines()
    assert calls == [f"old {scene} 30", f"new {scene} 30", f"old {scene} 15", f"new {scene} 15"]
    rows = read_csv(tmp_path / "rows.csv", QualityRow)
    assert [(each.budget, each.program, each.commit, each.psnr, each.chamfer) for each in rows] == [
        (15, "before", "0000001", 31, 2),
        (15, "after", "0000002", 32, 2),
        (30, "before", "0000001", 31, 2),
        (30, "after", "0000002", 32, 2),
    ]
    kept = json.loads((tmp_path / "runs" / "apple-30-0000001" / quality_over_time.SECONDS).read_text())
    assert kept == pytest.approx(rows[2].seconds, rel=1e-4)


@pytest.mark.parametrize("word", ["mgsr", "=mgsr", "0000001="])
def test_a_program_without_its_commit_or_command_is_refused(word: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=f"expected COMMIT=COMMAND, but got '{word}'"):
        quality_over_time.named(word)


def test_a_program_that_fails_ends_the_comparison(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="exit status 1"):
        quality_over_time.run("false", tmp_path, 30, tmp_path / "out")
    assert not (tmp_path / "out" / quality_over_time.SECONDS).exists()


def test_the_page_compares_the_programs_at_each_budget() -> None:
    rows = [row(Program.BEFORE, 15, 30, 2.5), row(Program.AFTER, 15, 31, 2), row(Program.BEFORE, 60, 33, 1.5)]
    rows.append(row(Program.AFTER, 60, 32.5, 1.6))
    text = quality_section(rows, "![plot](plot.svg)")
    assert "| apple | 15 | 15 | 15 | 30.00 | 31.00 | 2.50 | 2.00 |" in text and "![plot](plot.svg)" in text
    assert "- 15 s: PSNR +1.00 dB, Chamfer -0.50." in text and "- 60 s: PSNR -0.50 dB, Chamfer +0.10." in text
    assert "(0000001 and 0000002)" in text
    assert quality_section([], "") == ""


def test_the_plot_has_a_line_for_each_program(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="PLOTS NEED THE EXTRA bench")
    rows = [row(kind, budget, 30 + budget, 2) for kind in Program for budget in (15.0, 60.0)]
    text = write_quality_plot(tmp_path / "plot.svg", rows).read_text(encoding="utf-8")
    assert all(word in text for word in ("apple", "before", "after", "PSNR, dB", "Chamfer"))
