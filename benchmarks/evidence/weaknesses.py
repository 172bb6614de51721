"""The part of the evidence page on what is weak, which stands before anything that speaks for the program."""

from __future__ import annotations

from benchmarks.evidence.comparing import compare, is_busy, plain_runs
from benchmarks.evidence.quality_over_time import mean_gains
from benchmarks.evidence.result_files import Evidence
from benchmarks.evidence.training_length import early_ends
from mgsr.bench.results import Row


def weak_section(evidence: Evidence) -> str:
    """Return the list of what speaks against the program; empty where nothing does."""
    points = [*_weak_scores(evidence), *_weak_measurements(evidence)]
    return "## Weaknesses\n\n" + "\n".join(f"- {point}" for point in points) if points else ""


def _weak_scores(evidence: Evidence) -> list[str]:
    mgsr, points = plain_runs(evidence.rows), []
    surfels = plain_runs(evidence.rows, "2dgs")
    for score in ("chamfer", "normal_error"):
        found = compare(mgsr, surfels, score)
        if found is not None and len(found.worse) > len(found.better):
            points.append(f"The surface is no better than with the 2D branch alone: {found.words()}.")
    harmed = [row for row in evidence.rows if row.split_gain is not None and row.split_gain < 0]
    if harmed:
        summary = ", ".join(f"{_label(row)} {row.split_gain:.2f} dB" for row in harmed)
        points.append(
            f"The light split does harm, because the photograph itself is nearer to the matte object: {summary}."
        )
    low = [row for row in mgsr.values() if row.f_score is not None and row.f_score < 0.8]
    points += [f"On {row.scene} only {row.f_score:.0%} of the surface lies within 0.5% (F)." for row in low]
    points += [
        f"With a time budget of {budget:g} s, an older program renders better by {-psnr:.2f} dB."
        for budget, psnr, _ in mean_gains(evidence.quality)
        if psnr < 0
    ]
    ways = early_ends(evidence.all_rows)
    if ways and not any(way.pays for way in ways):
        most = max(ways, key=lambda way: way.saved)
        points.append(f"No shorter training pays. The largest saving is {most.words}: {most.meaning}.")
    return points


def _weak_measurements(evidence: Evidence) -> list[str]:
    rows, points = evidence.rows, []
    busy = [row for row in rows if row.seconds is not None and is_busy(row)]
    timed = [row for row in rows if row.seconds is not None]
    if busy:
        points.append(
            f"{len(busy)} of {len(timed)} runs shared the machine with other work. Their times are too long by an "
            "unknown share and cannot be compared."
        )
    presets = {row.preset for row in rows}
    if missing := [name for name in ("draft", "standard", "high") if name not in presets]:
        points.append(f"These presets have no run here: {', '.join(missing)}.")
    if len({row.seed for row in rows}) == 1:
        points.append("All runs have one seed, so this page does not show how much results vary by chance.")
    if not any(row.device == "cuda" for row in rows):
        points.append("No run on this page used a GPU; benchmarks/results/cuda.md has such runs.")
    if len({row.commit for row in timed}) > 1:
        points.append("The runs come from several commits; each row of the results names its own.")
    return points


def _label(row: Row) -> str:
    return " ".join(word for word in (row.scene, row.variant) if word)
