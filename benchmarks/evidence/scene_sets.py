"""The benchmark's two sets of scenes, as `benchmarks/scene_scores.py` measures them, and their evidence section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.bench.table import markdown, number

SETS = "sets.csv"
TUNING, JUDGING = "tuning", "judging"


@dataclass(frozen=True)
class SetRow:
    """One run of a scene of the sets.

    set: TUNING, on which settings are chosen, or JUDGING. Chamfer in thousandths of the object's radius, normal errors
    in degrees, PSNR of the test views in dB; hull_*: of the visual hull of the masks alone. floor_chamfer: of the true
    surface itself, which is the distance between two sets of points sampled on it. facet_angle: the mean angle, in
    degrees, between the normals with which the truth was shaded and those of its facets.
    """

    scene: str
    set: str
    kind: str
    chamfer: float
    normal_error: float
    hull_chamfer: float
    hull_normal_error: float
    floor_chamfer: float
    facet_angle: float
    psnr: float
    preset: str
    seed: int
    commit: str


def sets_section(rows: Sequence[SetRow]) -> str:
    """Return the tables of both sets and their means; empty without rows."""
    if not rows:
        return ""
    presets, seeds = (", ".join(sorted({str(getattr(row, name)) for row in rows})) for name in ("preset", "seed"))
    commits = ", ".join(dict.fromkeys(row.commit for row in rows))
    parts = [
        "## The tuning set and the judging set",
        "Settings are chosen on the tuning set alone. The judging set shows how they do on scenes for which nobody "
        f"tuned them. Preset: {presets}. Seed: {seeds}. Commit of the program: {commits}. `python -m "
        "benchmarks.scene_scores` makes these figures.",
        "The floor is the Chamfer of the true surface itself. It is not 0, as distances are between sampled points. "
        "Photographs show normals that are interpolated over the facets of the true mesh, but the normal error is that "
        "to the facets. The facet angle is the mean angle between the two: the error of a surface whose normals are "
        "exactly those of the photographs. A surface that shows the facets can have less. A scene with several seeds "
        "has the mean of its runs, followed by the range of their Chamfer.",
    ]
    for name in (TUNING, JUDGING):
        scenes = _by_scene([row for row in rows if row.set == name])
        if scenes:
            parts += [f"The {name} set:", _table(scenes), _means(name, scenes)]
    return "\n\n".join([*parts, *_gap(rows)])


def _by_scene(rows: Sequence[SetRow]) -> list[list[SetRow]]:
    """Return the runs of each scene, sorted by the share of the hull's Chamfer that remains."""
    scenes: dict[str, list[SetRow]] = {}
    for row in rows:
        scenes.setdefault(row.scene, []).append(row)
    return sorted(scenes.values(), key=_share)


def _mean(runs: Sequence[SetRow], field: str) -> float:
    return float(np.mean([getattr(run, field) for run in runs]))


def _share(runs: Sequence[SetRow]) -> float:
    return _mean(runs, "chamfer") / _mean(runs, "hull_chamfer")


def _table(scenes: Sequence[Sequence[SetRow]]) -> str:
    head = ["scene", "kind", "Chamfer (floor, hull)", "of the hull's", "normal error (facet angle, hull)", "PSNR"]
    cells = [
        [
            runs[0].scene,
            runs[0].kind,
            f"{_mean_and_range(runs)} ({runs[0].floor_chamfer:.2f}, {runs[0].hull_chamfer:.2f})",
            f"{_share(runs):.0%}",
            f"{_mean(runs, 'normal_error'):.1f} ({runs[0].facet_angle:.1f}, {runs[0].hull_normal_error:.1f})",
            number(_mean(runs, "psnr"), ".2f"),
        ]
        for runs in scenes
    ]
    return markdown(head, cells)


def _mean_and_range(runs: Sequence[SetRow]) -> str:
    """Return the mean Chamfer, followed by the least and the largest of several runs."""
    values = [run.chamfer for run in runs]
    return f"{np.mean(values):.2f}" + (f", {min(values):.2f} to {max(values):.2f}" if len(values) > 1 else "")


def _means(name: str, scenes: Sequence[Sequence[SetRow]]) -> str:
    above = [runs[0].scene for runs in scenes if _share(runs) > 1]
    fields = "chamfer", "normal_error", "facet_angle"
    chamfer, error, facets = (np.mean([_mean(runs, field) for runs in scenes]) for field in fields)
    worse = (
        (f" These scenes are worse than their hull: {', '.join(above)}.")
        if above
        else " No scene is worse than its hull."
    )
    count = "1 scene" if len(scenes) == 1 else f"{len(scenes)} scenes"
    return (
        f"The {name} set's {count} have a mean Chamfer of {chamfer:.2f} and a mean normal error of {error:.1f} "
        f"degrees, with a mean facet angle of {facets:.1f}.{worse}"
    )


def _gap(rows: Sequence[SetRow]) -> list[str]:
    shares = [[_share(runs) for runs in _by_scene([r for r in rows if r.set == name])] for name in (TUNING, JUDGING)]
    if not all(shares):
        return []
    tuning, judging = (np.mean(of_set) for of_set in shares)
    return [
        f"On average, Chamfer is {tuning:.0%} of the hull's on the tuning set and {judging:.0%} on the judging set."
    ]
