"""The benchmark's two sets of scenes, as `benchmarks/scene_scores.py` measures them, and their evidence section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mgsr.bench.table import markdown, number

SETS = "sets.csv"
TUNING, JUDGING = "tuning", "judging"


@dataclass(frozen=True)
class SetRow:
    """One run of a scene of the sets.

    set: TUNING, on which settings are chosen, or JUDGING. Chamfer in thousandths of the object's radius, normal errors
    in degrees, PSNR of the test views in dB; hull_*: of the visual hull of the masks alone.
    """

    scene: str
    set: str
    kind: str
    chamfer: float
    normal_error: float
    hull_chamfer: float
    hull_normal_error: float
    psnr: float
    preset: str
    seed: int
    commit: str


def sets_section(rows: Sequence[SetRow]) -> str:
    """Return the tables of both sets and their means; empty without rows."""
    if not rows:
        return ""
    presets, seeds = ", ".join(sorted({row.preset for row in rows})), ", ".join(sorted({str(row.seed) for row in rows}))
    commits = ", ".join(dict.fromkeys(row.commit for row in rows))
    parts = [
        "## The tuning set and the judging set",
        "Settings are chosen on the tuning set alone. The judging set shows how they do on scenes for which nobody "
        f"tuned them. The preset is {presets}, the seed {seeds}, the program that of {commits}. `python -m "
        "benchmarks.scene_scores` makes these figures.",
    ]
    for name in (TUNING, JUDGING):
        of_set = [row for row in rows if row.set == name]
        if of_set:
            parts += [f"The {name} set:", _table(of_set), _means(name, of_set)]
    return "\n\n".join([*parts, *_gap(rows)])


def _table(rows: Sequence[SetRow]) -> str:
    head = ["scene", "kind", "Chamfer (hull)", "of the hull's", "normal error (hull)", "PSNR"]
    cells = [
        [
            row.scene,
            row.kind,
            f"{row.chamfer:.2f} ({row.hull_chamfer:.2f})",
            f"{row.chamfer / row.hull_chamfer:.0%}",
            f"{row.normal_error:.1f} ({row.hull_normal_error:.1f})",
            number(row.psnr, ".2f"),
        ]
        for row in sorted(rows, key=lambda row: row.chamfer / row.hull_chamfer)
    ]
    return markdown(head, cells)


def _means(name: str, rows: Sequence[SetRow]) -> str:
    count, above = len(rows), [row.scene for row in rows if row.chamfer > row.hull_chamfer]
    chamfer, error = (sum(getattr(row, field) for row in rows) / count for field in ("chamfer", "normal_error"))
    worse = (
        (f" These scenes are worse than their hull: {', '.join(above)}.")
        if above
        else " No scene is worse than its hull."
    )
    scenes = "1 scene" if count == 1 else f"{count} scenes"
    return (
        f"The {name} set's {scenes} have a mean Chamfer of {chamfer:.2f} and a mean normal error of {error:.1f} "
        f"degrees.{worse}"
    )


def _gap(rows: Sequence[SetRow]) -> list[str]:
    shares = [[row.chamfer / row.hull_chamfer for row in rows if row.set == name] for name in (TUNING, JUDGING)]
    if not all(shares):
        return []
    tuning, judging = (sum(of_set) / len(of_set) for of_set in shares)
    return [
        f"On average, Chamfer is {tuning:.0%} of the hull's on the tuning set and {judging:.0%} on the judging set."
    ]
