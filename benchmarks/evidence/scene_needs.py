"""The part of the evidence page on what a scene needs.

It shows models from simple to hard scenes, what each part that a run leaves out, or makes do with less of, would have
brought, and runs that were given a time.
"""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.evidence.comparing import SCORES, held_against, is_busy, plain_runs
from mgsr.bench.ablations import NEED_ROWS, AblationRow
from mgsr.bench.cells import of_row
from mgsr.bench.results import Row
from mgsr.bench.table import markdown, number

BUDGET = "time_budget="
SHORT, LONG = 0.9, 1.05  # shares of its time between which a run with a budget shall end
DIFFERENCES = ("psnr", "chamfer", "normal_consistency")


def need_section(rows: Sequence[Row], behind: Sequence[Row], ordered: Sequence[str], images: Sequence[str]) -> str:
    """Return the section on what a scene needs, as Markdown.

    rows: the newest of each cell; behind: older ones that variants of their commit are compared with. ordered: the
    scenes' names from the simplest to the hardest; images: Markdown of the plots that belong here.
    """
    runs = plain_runs(rows)
    parts = (
        "## Simple models for simple scenes",
        "A simple scene should end as a simple model. The scenes are sorted from the simplest to the hardest, by "
        "the Chamfer distance of the hull:",
        _models([runs[scene] for scene in ordered if scene in runs]),
        *images,
        *_parts_left_out([*rows, *behind], ordered),
        *_budgets(rows, ordered),
    )
    return "\n\n".join(part for part in parts if part)


def _models(runs: Sequence[Row]) -> str:
    head = ["scene", "surfels", "gaussians", "splats, MiB", "faces", "peak memory, MiB", "seconds"]
    cells = [
        [row.scene, str(row.surfels), str(row.gaussians), number(row.model_mib, ".1f"), str(row.faces),
         number(row.memory_mib, ".0f"), _seconds(row)]
        for row in runs
    ]  # fmt: skip
    return "\n\n".join([markdown(head, cells), *_size_words(runs)])


def _size_words(rows: Sequence[Row]) -> list[str]:
    if len(rows) < 2:
        return []
    sizes = [row.model_mib for row in rows if row.model_mib is not None]
    first = rows[0].model_mib or 0
    return [f"The splats of the simplest scene take {first:.1f} MiB, those of the largest model {max(sizes):.1f} MiB."]


def _parts_left_out(rows: Sequence[Row], ordered: Sequence[str]) -> list[str]:
    """Return a table of the scenes on which rows were run: the figures, and their difference to the method's."""
    cells, missing = [], []
    for row in NEED_ROWS:
        own = plain_runs(rows, row.method, of_row(row).name)
        method = held_against(own, rows)
        lines = [_line(row, own[scene], method[scene]) for scene in ordered if scene in method]
        cells += lines
        missing += [] if lines else [row.name]
    if not cells:
        return []
    head = ["change", "scene", "PSNR", "Chamfer", "NC", "splats", "seconds"]
    return [
        "Each row gives a run more than MGSR would. Brackets give the difference to the default run. What improves "
        "no figure and costs splats or seconds was rightly left out:",
        markdown(head, cells),
        *([f"These were not run: {', '.join(missing)}."] if missing else []),
    ]


def _line(row: AblationRow, own: Row, method: Row) -> list[str]:
    cells = [row.meaning, own.scene]
    for score in DIFFERENCES:
        mine, other, form = getattr(own, score), getattr(method, score), SCORES[score][2]
        cells.append("-" if mine is None or other is None else f"{mine:{form}} ({mine - other:+z{form}})")
    cells.append(f"{own.splats} ({_share(own.splats, method.splats)})")
    busy = is_busy(own) or is_busy(method)
    return [*cells, "busy" if busy else f"{own.seconds:.0f} ({_share(own.seconds, method.seconds)})"]


def _share(own: float | None, method: float | None) -> str:
    return "-" if not own or not method else f"{own / method - 1:+z.0%}"


def _budgets(rows: Sequence[Row], ordered: Sequence[str]) -> list[str]:
    """Return a table of the runs that were given a time, by scene and time."""
    given = [(ordered.index(row.scene), _given(row), row) for row in rows if _is_given(row) and row.scene in ordered]
    if not given:
        return []
    given.sort(key=lambda each: each[:2])
    cells = [
        [row.scene, f"{seconds:.0f}", _seconds(row), f"{(row.seconds or 0) / seconds:.0%}", number(row.psnr, ".2f"),
         number(row.chamfer, ".2f"), number(row.normal_consistency, ".2f")]
        for _, seconds, row in given
    ]  # fmt: skip
    within = sum(SHORT <= (row.seconds or 0) / seconds <= LONG for _, seconds, row in given)
    return [
        f"Runs with `--time-budget` should end at {SHORT:.0%} to {LONG:.0%} of the budget. {within} of {len(given)} "
        "did.",
        markdown(["scene", "given, s", "taken, s", "share", "PSNR", "Chamfer", "NC"], cells),
    ]


def _is_given(row: Row) -> bool:
    return row.variant.startswith(BUDGET)


def _given(row: Row) -> float:
    return float(row.variant.removeprefix(BUDGET))


def _seconds(row: Row) -> str:
    return number(row.seconds, ".0f") + ("*" if is_busy(row) else "")
