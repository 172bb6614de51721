"""The scores that a report explains: their names, formats and meanings."""

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
        "How close renders come to photographs that training never saw. 3 dB more means half the squared error.",
    ),
    Score(
        "psnr_fg_test",
        "PSNR on the object",
        1,
        2,
        "dB",
        "The PSNR of the object's pixels alone, which an empty background cannot improve.",
    ),
    Score(
        "ssim_test",
        "SSIM",
        1,
        4,
        "",
        "How similar the local structure of renders and photographs is. 1 means identical.",
    ),
    Score(
        "psnr_whole_test",
        "PSNR with the background",
        1,
        2,
        "dB",
        "The same score for the whole photographs: the object before the background, which has splats of its own.",
    ),
)
SURFACE = (
    Score(
        "chamfer",
        "Chamfer distance",
        1000,
        2,
        "‰",
        "The mean distance between this surface and the true one, in both directions, in thousandths of the "
        "object's radius.",
    ),
    Score("accuracy", "Accuracy", 1000, 2, "‰", "The mean distance from this surface to the true one."),
    Score(
        "completeness",
        "Completeness",
        1000,
        2,
        "‰",
        "The mean distance from the visible true surface to this one.",
    ),
    Score(
        "f_005",
        "F-score at 0.5%",
        1,
        3,
        "",
        "The share of both surfaces that lies within 0.5% of the object's radius of the other. 1 means all.",
    ),
    Score("f_010", "F-score at 1%", 1, 3, "", "The same share within 1%."),
    Score("f_020", "F-score at 2%", 1, 3, "", "The same share within 2%."),
    Score(
        "normal_consistency",
        "Normal consistency",
        100,
        1,
        "%",
        "How well the normals of nearest points agree. 100 means that all are equal.",
    ),
    Score(
        "normal_error",
        "Normal error",
        1,
        1,
        "°",
        "The mean angle between the normals of this surface and the true one, over the pixels of the test views.",
    ),
    Score(
        "mask_iou",
        "Silhouette overlap",
        100,
        1,
        "%",
        "The overlap of both silhouettes in the test views. 100 means identical.",
    ),
)
SPLIT = (
    Score(
        "split_gain",
        "Light split",
        1,
        2,
        "dB",
        "How much closer transmitted light is to the object without gloss than the photograph is.",
    ),
)


def scores_told(data: ReportData) -> Iterator[tuple[Score, str]]:
    """Yield the scores of a run, each with its formatted value."""
    split = {} if data.split is None else asdict(data.split)
    for scores, values in ((IMAGE, vars(data)), (SURFACE, data.gt or {}), (SPLIT, split)):
        for score in scores:
            value = values.get(score.name)
            if isinstance(value, int | float) and math.isfinite(value):
                yield score, f"{value * score.factor:.{score.digits}f}{_unit(score)}"


def _unit(score: Score) -> str:
    return score.unit if score.unit in ("", "°") else f" {score.unit}"
