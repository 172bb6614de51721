"""Quality over time, as `benchmarks/quality_over_time.py` measures it, its plot and its section of the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from statistics import mean

from mgsr.bench.plots import COLORS, TEXT, new_figure, plot_style, write_svg
from mgsr.bench.table import markdown

QUALITY = "quality_over_time.csv"
PLOT = "quality_over_time.svg"
SCORES = (("chamfer", "Chamfer × 1000"), ("psnr", "PSNR, dB"))


class Program(StrEnum):
    """Which of the two compared programs made a run."""

    BEFORE = "before"
    AFTER = "after"


@dataclass(frozen=True)
class QualityRow:
    """One run with a time budget.

    budget: the budget, in seconds. program: `Program`. commit: of the program. seconds: of the whole command. psnr: of
    the test views on white, in dB. chamfer: in thousandths of the object's radius.
    """

    scene: str
    budget: float
    program: str
    commit: str
    seconds: float
    psnr: float
    chamfer: float

    @property
    def cell(self) -> tuple[str, float, int]:
        """Return what identifies the run, in the order of the file."""
        return self.scene, self.budget, list(Program).index(Program(self.program))


def write_quality_plot(path: Path, rows: Sequence[QualityRow]) -> Path:
    """Plot each score over seconds, with a column of panels for each scene and a line for each program.

    Returns the path.
    """
    scenes = list(dict.fromkeys(row.scene for row in rows))
    colors = {Program.BEFORE: TEXT, Program.AFTER: COLORS["mgsr"]}
    with plot_style():
        figure = new_figure(2.4 * len(scenes) + 0.6, 4.0)
        panels = figure.subplots(len(SCORES), len(scenes), squeeze=False, sharex=True)
        for column, scene in enumerate(scenes):
            panels[0][column].set_title(scene, fontsize=9)
            panels[-1][column].set_xlabel("seconds of the whole run")
            for line, (score, label) in enumerate(SCORES):
                panel = panels[line][column]
                for program, color in colors.items():
                    own = [row for row in rows if (row.scene, row.program) == (scene, program)]
                    values = [getattr(row, score) for row in own]
                    panel.plot([row.seconds for row in own], values, "o-", markersize=4, color=color, label=program)
                panel.set_ylabel(label if column == 0 else "")
        panels[0][0].set_xlim(left=0)  # of all panels, which share the axis
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=len(colors))
        return write_svg(figure, path)


def quality_section(rows: Sequence[QualityRow], plot: str) -> str:
    """Return the plot, the table and the mean gains, as Markdown; empty without rows.

    plot: the Markdown of the plot.
    """
    if not rows:
        return ""
    pairs = _pairs(rows)
    cells = [
        [new.scene, f"{new.budget:g}", f"{old.seconds:.0f}", f"{new.seconds:.0f}", f"{old.psnr:.2f}",
         f"{new.psnr:.2f}", f"{old.chamfer:.2f}", f"{new.chamfer:.2f}"]
        for old, new in pairs
    ]  # fmt: skip
    gains = [
        f"- {budget:g} s: PSNR {psnr:+.2f} dB, Chamfer {chamfer:+.2f}." for budget, psnr, chamfer in mean_gains(rows)
    ]
    return "\n\n".join(
        (
            "## Quality over time",
            "Each run has the preset `standard` and a time budget. An older program and a newer one "
            f"({_commits(rows, Program.BEFORE)} and {_commits(rows, Program.AFTER)}) ran in turns on one machine. "
            "Seconds are those of the whole command, which also starts Python and writes the report. "
            "`python -m benchmarks.quality_over_time` makes these figures.",
            plot,
            markdown(
                ["scene", "budget, s", "seconds before", "after", "PSNR before", "after", "Chamfer before", "after"],
                cells,
            ),
            "The mean differences, after minus before:",
            "\n".join(gains),
        )
    )


def mean_gains(rows: Sequence[QualityRow]) -> list[tuple[float, float, float]]:
    """Return each budget with the mean differences of PSNR and of Chamfer, after minus before."""
    pairs = _pairs(rows)
    found = []
    for budget in sorted({new.budget for _, new in pairs}):
        own = [(old, new) for old, new in pairs if new.budget == budget]
        psnr, chamfer = (
            mean(getattr(new, name) - getattr(old, name) for old, new in own) for name in ("psnr", "chamfer")
        )
        found.append((budget, psnr, chamfer))
    return found


def _pairs(rows: Sequence[QualityRow]) -> list[tuple[QualityRow, QualityRow]]:
    """Return the runs of both programs with equal scene and budget, the older program's first."""
    by = {row.cell[:2]: row for row in rows if row.program == Program.BEFORE}
    return [(by[row.cell[:2]], row) for row in rows if row.program == Program.AFTER]


def _commits(rows: Sequence[QualityRow], program: Program) -> str:
    return ", ".join(dict.fromkeys(row.commit for row in rows if row.program == program))
