"""The part of the evidence page on the paper's ablation rows and on our choices beside the paper's."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.evidence.comparing import SCORES, compare, held_against, is_busy, plain_runs, seed_spread, verdict
from mgsr.bench.ablations import PAPER_CHOICES, PAPER_ROWS, AblationRow, named_rows
from mgsr.bench.cells import of_row
from mgsr.bench.results import Row
from mgsr.bench.table import markdown, number


@dataclass(frozen=True)
class PaperMeans:
    """The means over the paper's 30 OmniObject3D objects (supplement, Tables 6 to 12).

    PSNR in dB, normal consistency times 100, Chamfer times 1000; None where the table gives no mean or the row has no
    such output.
    """

    psnr: float | None = None
    normal_consistency: float | None = None
    chamfer: float | None = None


# A and L leave out objects on which they failed. The supplement gives no means for G, H, J and N.
PAPER_MEANS = {
    "A": PaperMeans(35.1041),
    "B": PaperMeans(None, 90.1606, 0.9157),
    "C": PaperMeans(37.8808, 90.5413, 0.9186),
    "D": PaperMeans(36.9948, 90.6208, 0.9178),
    "E": PaperMeans(37.6928, 90.6024, 0.9018),
    "F": PaperMeans(36.4242, 90.5987, 0.9116),
    "K": PaperMeans(36.6413, 90.5735, 0.9076),
    "L": PaperMeans(37.0137, 90.5650, 0.9179),
}

# What the paper found, as comparisons of the method E with another row: the finding, the row, and the scores that
# should be better with E.
FINDINGS = (
    ("The 2D branch improves the renders: both branches beat the 3D branch alone", "A", ("psnr", "split_gain")),
    (
        "The 3D branch improves the surface: both branches beat the 2D branch alone",
        "B",
        ("normal_consistency", "chamfer"),
    ),
    ("A larger weight of the 3D branch worsens the surface", "C", ("normal_consistency", "chamfer")),
    ("A larger weight of the 2D branch worsens the renders", "D", ("psnr",)),
    ("A larger weight of the mutual depth loss does harm", "F", ("psnr", "normal_consistency", "chamfer")),
    ("A quarter of the mutual phase is too little", "G", ("psnr", "normal_consistency", "chamfer")),
    ("Half of the mutual phase is too little", "H", ("psnr", "normal_consistency", "chamfer")),
    ("More of the mutual phase only takes longer", "J", ("seconds",)),
    ("Gradients into both branches help", "K", ("psnr", "normal_consistency", "chamfer")),
    ("Early stopping saves time at equal quality", "L", ("seconds", "psnr", "normal_consistency", "chamfer")),
    ("Losses of total variation help", "N", ("psnr", "normal_consistency", "chamfer")),
)

OURS = ("psnr", "normal_consistency", "chamfer", "split_gain", "seconds")


def ablation_section(rows: Sequence[Row]) -> str:
    """Return the table of the ablation rows beside the paper's means, and each finding's verdict, as Markdown."""
    return "\n\n".join(
        (
            "## The paper's ablation rows",
            "Each row changes one thing in the method. [mgsr/config/paper.py](../mgsr/config/paper.py) has the "
            "settings; the published weights of C, D and F are unknown, so they are MGSR's. MGSR's figures are "
            "means over the scenes on which both the row and the method were run at the same commit. Brackets give "
            "the difference to the method. The paper's figures are means over 30 other objects, at another size and "
            "scale, so compare only the differences. A dash means that the supplement gives no mean, or that the "
            "row has no such output.",
            _table(PAPER_ROWS, rows),
            "The findings of the paper, and whether they hold here (`standard`). A finding holds if it holds on "
            f"every scene ({_about_seeds(rows)}):",
            "\n".join(_finding(finding, name, scores, rows) for finding, name, scores in FINDINGS),
        )
    )


def choices_section(rows: Sequence[Row]) -> str:
    """Return the table of our defaults beside the paper's choices, as Markdown."""
    missing = [row.name for row in PAPER_CHOICES if not held_against(_runs(row, rows), rows)]
    parts = [
        "## Where a default differs from the paper's",
        "Each row uses the paper's choice. Brackets give the difference to MGSR's default on the same scenes.",
        _table([row for row in PAPER_CHOICES if row.name not in missing], rows, paper=False),
    ]
    if missing:
        parts.append(f"These rows were not run, so this page cannot show why they differ: {', '.join(missing)}.")
    return "\n\n".join(part for part in parts if part)


def _runs(row: AblationRow, rows: Sequence[Row]) -> dict[str, Row]:
    return plain_runs(rows, row.method, of_row(row).name)


def _table(chosen: Sequence[AblationRow], rows: Sequence[Row], paper: bool = True) -> str:
    """Return a table of ablation rows; rows that were not run have dashes, and without a row there is no table."""
    if not chosen:
        return ""
    head = ["row", "change", "scenes", "PSNR", "NC", "Chamfer", "split gain", "seconds"]
    head += ["paper: PSNR", "NC", "Chamfer"] if paper else []
    return markdown(head, [_cells(row, rows, paper) for row in chosen])


def _cells(row: AblationRow, rows: Sequence[Row], paper: bool) -> list[str]:
    own = _runs(row, rows)
    method = held_against(own, rows)
    shared = [scene for scene in own if scene in method]
    cells = [row.name, row.meaning, str(len(shared)) if shared else "not run"]
    cells += [_our_mean(score, [own[s] for s in shared], [method[s] for s in shared]) for score in OURS]
    return cells + (_paper_means(PAPER_MEANS.get(row.name, PaperMeans()), PAPER_MEANS["E"]) if paper else [])


def _our_mean(score: str, own: Sequence[Row], method: Sequence[Row]) -> str:
    """Return the mean of a score, and its difference to the method's where that is another run."""
    pairs = [
        (getattr(a, score), getattr(b, score))
        for a, b in zip(own, method, strict=True)
        if getattr(a, score) is not None and getattr(b, score) is not None
    ]
    if not pairs:
        return "-"
    if score == "seconds" and any(is_busy(row) for row in (*own, *method)):
        return "busy"
    form = SCORES[score][2]
    mean, other = (statistics.fmean(column) for column in zip(*pairs, strict=True))
    return f"{mean:{form}}" if own == method else f"{mean:{form}} ({mean - other:+z{form}})"


def _paper_means(paper: PaperMeans, method: PaperMeans) -> list[str]:
    pairs = (
        (paper.psnr, method.psnr, ".2f"),
        (paper.normal_consistency, method.normal_consistency, ".2f"),
        (paper.chamfer, method.chamfer, ".3f"),
    )
    return [
        "-" if own is None or other is None
        else f"{own:{form}}" if own == other
        else f"{own:{form}} ({own - other:+z{form}})"
        for own, other, form in pairs
    ]  # fmt: skip


def _finding(finding: str, name: str, scores: Sequence[str], rows: Sequence[Row]) -> str:
    """Return a line of the list: the finding, then each score's verdict and figures."""
    sentences, own = [], _runs(named_rows()[name], rows)
    method = held_against(own, rows)
    for score in scores:
        found = compare(method, own, score)
        if found is None:
            continue
        if score == "seconds" and found.busy:
            sentences.append("time: unknown, because the machine was busy")
            continue
        sentences.append(f"**{verdict(found, seed_spread(rows, score))}**: {found.words()}")
    return f"- {finding} (row {name}). " + (" ".join(f"{words}." for words in sentences) or "These rows were not run.")


def _about_seeds(rows: Sequence[Row]) -> str:
    known = {SCORES[score][0]: seed_spread(rows, score) for score in ("psnr", "normal_consistency", "chamfer")}
    if any(value is None for value in known.values()):
        return "no scene was run with several seeds, so small differences may be due to chance"
    spreads = ", ".join(f"{name} {number(value, '.2f')}" for name, value in known.items())
    return f"differences below the spread between seeds do not count: {spreads}"
