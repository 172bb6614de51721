"""All result files of benchmarks/results as one value."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.evidence.exposures import EXPOSURES, ExposureRow
from benchmarks.evidence.kernels import CHOICES, KERNELS, KernelRow, read_kernels
from benchmarks.evidence.masks import MASKS, MaskRow
from benchmarks.evidence.quality_over_time import QUALITY, QualityRow
from benchmarks.evidence.relighting import RELIGHTING, RelightingRow
from benchmarks.evidence.scene_sets import SETS, SetRow
from benchmarks.evidence.surface_parts import FINISH_PARTS, START_PARTS, PartRow
from mgsr.bench.csv_rows import read_csv
from mgsr.bench.results import CURVES, DONE, RUNS, Curve, Row, latest, read_curves, read_rows

SCENES = "scenes.csv"
IMAGES = Path("images") / "evidence"  # in the folder of the documentation


@dataclass(frozen=True)
class SceneFacts:
    """The facts of a scene, and what the visual hull of its masks alone scores."""

    scene: str
    what: str
    hull_chamfer: float
    hull_f_score: float
    hull_normal_error: float


@dataclass(frozen=True)
class Evidence:
    """All result files.

    rows: of each cell the newest; behind: those that gave way to newer ones, which variants of their commit are
    compared with. choices: kernels in which something was chosen otherwise.
    """

    rows: list[Row]
    curves: list[Curve]
    scenes: list[SceneFacts]
    kernels: list[KernelRow]
    exposures: list[ExposureRow] = field(default_factory=list)
    behind: list[Row] = field(default_factory=list)
    choices: list[KernelRow] = field(default_factory=list)
    sets: list[SetRow] = field(default_factory=list)
    start: list[PartRow] = field(default_factory=list)
    finish: list[PartRow] = field(default_factory=list)
    relighting: list[RelightingRow] = field(default_factory=list)
    quality: list[QualityRow] = field(default_factory=list)
    masks: list[MaskRow] = field(default_factory=list)

    @property
    def all_rows(self) -> list[Row]:
        return [*self.rows, *self.behind]


def read_evidence(results: Path) -> Evidence:
    """Read the files of a results folder."""
    with open(results / SCENES, newline="", encoding="utf-8") as file:
        scenes = [
            SceneFacts(row.pop("scene"), row.pop("what"), *(float(text) for text in row.values()))
            for row in csv.DictReader(file)
        ]
    rows = [row for row in read_rows(results / RUNS) if row.state == DONE]
    newest = latest(rows)
    kernels, choices = (read_kernels(results / name) for name in (KERNELS, CHOICES))
    exposures = read_csv(results / EXPOSURES, ExposureRow)
    curves, behind = read_curves(results / CURVES), [row for row in rows if row not in newest]
    sets = read_csv(results / SETS, SetRow)
    start, finish = (read_csv(results / name, PartRow) for name in (START_PARTS, FINISH_PARTS))
    relighting = read_csv(results / RELIGHTING, RelightingRow)
    quality, masks = read_csv(results / QUALITY, QualityRow), read_csv(results / MASKS, MaskRow)
    return Evidence(
        newest, curves, scenes, kernels, exposures, behind, choices, sets, start, finish, relighting, quality, masks
    )


def image(name: str) -> str:
    """Return the path of an image, as the page names it."""
    return (IMAGES / name).as_posix()
