"""The part of the evidence page on the paper's ablation rows and on our choices beside the paper's."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from mgsr.bench.ablations import FINDINGS, PAPER_CHOICES, PAPER_ROWS, AblationRow, PaperMeans, named_rows
from mgsr.bench.cells import of_row
from mgsr.bench.comparing import SCORES, compare, held_against, is_busy, plain_runs, seed_spread, verdict
from mgsr.bench.results import Row
from mgsr.bench.table import markdown, number

OURS = ("psnr", "normal_consistency", "chamfer", "split_gain", "seconds")


def ablation_section(rows: Sequence[Row]) -> str:
    """Return the table of the ablation rows beside the paper's means, and each finding's verdict, as Markdown."""
    return "\n\n".join(
        (
            "## The paper's ablation rows",
            "Each row is the method with one thing changed (settings in [mgsr/config.py](../mgsr/config.py); the "
            "published weights of C, D and F are not known, so those are ours). Our figures are means over the scenes "
            "on which both the row and the method were run at the same commit, and in brackets the difference to the "
            "method. The paper's are means over 30 other objects, at "
            "another size and scale: only the differences can be held against each other. A dash: the supplement gives "
            "no mean, or no such output.",
            _table(PAPER_ROWS, rows),
            "What the paper found, and whether it holds here (`standard`; a finding holds where every scene says so, "
            f"and {_about_seeds(rows)}):",
            "\n".join(_finding(finding, name, scores, rows) for finding, name, scores in FINDINGS),
        )
    )


def choices_section(rows: Sequence[Row]) -> str:
    """Return the table of our defaults beside the paper's choices, as Markdown."""
    missing = [row.name for row in PAPER_CHOICES if not held_against(_runs(row, rows), rows)]
    parts = [
        "## Where a default differs from the paper's",
        "Each row takes the paper's choice back; in brackets, the difference to our default on the same scenes.",
        _table([row for row in PAPER_CHOICES if row.name not in missing], rows, paper=False),
    ]
    if missing:
        parts.append(f"Not run yet, so nothing here shows why these differ: {', '.join(missing)}.")
    return "\n\n".join(part for part in parts if part)


def _runs(row: AblationRow, rows: Sequence[Row]) -> dict[str, Row]:
    return plain_runs(rows, row.method, of_row(row).name)


def _table(chosen: Sequence[AblationRow], rows: Sequence[Row], paper: bool = True) -> str:
    """Return a table of ablation rows; rows that were not run have dashes, and without a row there is no table."""
    if not chosen:
        return ""
    head = ["row", "what it changes", "scenes", "PSNR", "NC", "Chamfer", "split gain", "seconds"]
    head += ["paper: PSNR", "NC", "Chamfer"] if paper else []
    return markdown(head, [_cells(row, rows, paper) for row in chosen])


def _cells(row: AblationRow, rows: Sequence[Row], paper: bool) -> list[str]:
    own = _runs(row, rows)
    method = held_against(own, rows)
    shared = [scene for scene in own if scene in method]
    cells = [row.name, row.meaning, str(len(shared)) if shared else "not run"]
    cells += [_our_mean(score, [own[s] for s in shared], [method[s] for s in shared]) for score in OURS]
    return cells + (_paper_means(row.paper, named_rows()["E"].paper) if paper else [])


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
    told, own = [], _runs(named_rows()[name], rows)
    method = held_against(own, rows)
    for score in scores:
        found = compare(method, own, score)
        if found is None:
            continue
        if score == "seconds" and found.busy:
            told.append("time: the machine was busy, so it can't be told")
            continue
        told.append(f"**{verdict(found, seed_spread(rows, score))}**: {found.words()}")
    return f"- {finding} (row {name}). " + (" ".join(f"{words}." for words in told) or "Not run yet.")


def _about_seeds(rows: Sequence[Row]) -> str:
    known = {SCORES[score][0]: seed_spread(rows, score) for score in ("psnr", "normal_consistency", "chamfer")}
    if any(value is None for value in known.values()):
        return "no scene was run with several seeds, so small differences may be chance"
    spreads = ", ".join(f"{name} {number(value, '.2f')}" for name, value in known.items())
    return f"the spread between seeds, below which no difference counts, is {spreads}"
