"""The scores that a report explains: the name of each, its form, and its meaning in a sentence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from mgsr.report.data import ReportData


@dataclass(frozen=True)
class Score:
    """A score's name in report.json, its label, factor, digits, unit and meaning."""

    name: str
    label: str
    factor: float
    digits: int
    unit: str
    meaning: str


IMAGE = (
    Score(
        "psnr_test",
        "PSNR",
        1,
        2,
        "dB",
        "How close the renders come to photographs that training never saw; 3 dB more is half the squared error.",
    ),
    Score(
        "psnr_fg_test",
        "PSNR on the object",
        1,
        2,
        "dB",
        "The same, counting only pixels of the object: an empty background can't flatter it.",
    ),
    Score(
        "psnr_whole_test",
        "PSNR with the background",
        1,
        2,
        "dB",
        "The same for the whole photographs: the object before the background, which has splats of its own.",
    ),
    Score("ssim_test", "SSIM", 1, 4, "", "How alike the local structure of renders and photographs is; 1 is the same."),
)
SURFACE = (
    Score(
        "chamfer",
        "Chamfer distance",
        1000,
        2,
        "‰",
        "The mean distance between this surface and the true one, both ways, per thousand of the object's radius.",
    ),
    Score("accuracy", "Accuracy", 1000, 2, "‰", "The mean distance from this surface to the true one."),
    Score(
        "completeness",
        "Completeness",
        1000,
        2,
        "‰",
        "The mean distance from the true surface, where views saw it, to this one.",
    ),
    Score(
        "f_005",
        "F-score at 0.5%",
        1,
        3,
        "",
        "The share of both surfaces that lies within 0.5% of the object's radius of the other; 1 is all.",
    ),
    Score("f_010", "F-score at 1%", 1, 3, "", "The same within 1%."),
    Score("f_020", "F-score at 2%", 1, 3, "", "The same within 2%."),
    Score(
        "normal_consistency",
        "Normal consistency",
        100,
        1,
        "%",
        "How well the directions of nearest places agree; 100 is everywhere the same.",
    ),
    Score(
        "normal_error",
        "Normal error",
        1,
        1,
        "°",
        "The mean angle between this surface and the true one, pixel by pixel in the test views.",
    ),
    Score("mask_iou", "Outline", 100, 1, "%", "How much of both outlines overlaps in the test views."),
)
SPLIT = (
    Score(
        "split_gain",
        "Light split",
        1,
        2,
        "dB",
        "How much closer the transmitted light comes to the object without gloss than the photograph does.",
    ),
)


def scores_told(data: ReportData) -> Iterator[tuple[Score, str]]:
    """Yield the scores that this run has, each with its value written out."""
    split = {} if data.split is None else asdict(data.split)
    for scores, values in ((IMAGE, vars(data)), (SURFACE, data.gt or {}), (SPLIT, split)):
        for score in scores:
            value = values.get(score.name)
            if isinstance(value, int | float) and math.isfinite(value):
                yield score, f"{value * score.factor:.{score.digits}f}{_unit(score)}"


def _unit(score: Score) -> str:
    return score.unit if score.unit in ("", "°") else f" {score.unit}"
