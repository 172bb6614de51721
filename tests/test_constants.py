"""Numbers that decide results are options: the constants that remain in the algorithms, each with its reason."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGES = (
    *("densify", "geometry", "inspection", "mesh", "pipeline"),
    *("segmentation", "shading", "start", "stereo", "training"),
)
ROOT = Path(__file__).resolve().parents[1] / "mgsr"

MATHEMATICS = "mathematics, or a standard"
BATCH = "how much is handled or kept at a time: it costs memory and time, and changes no result"
PROGRESS = "shares of a progress bar, and estimates of time"
FORMAT = "a file's or an array's own form"
SEARCHED = "the candidates of a search, whose result may lie between them"
ROUNDING = "how far rounding may move an input"
PICTURES = "what a report shows"
SAFETY = "limits that a sound training never meets"

REMAINING = {
    "geometry/bilateral_filter.CHUNK": BATCH,
    "geometry/charts.CELL": FORMAT,
    "geometry/low_frequency.CHUNK": BATCH,
    "geometry/precision._LOSS": MATHEMATICS,
    "inspection/findings._NAMED": PICTURES,
    "mesh/baking._ROWS_AT_ONCE": BATCH,
    "mesh/baking._TEXELS_AT_ONCE": BATCH,
    "mesh/pixels._ALL": MATHEMATICS,
    "mesh/pixels._HEAD": MATHEMATICS,
    "mesh/pixels._TAIL": MATHEMATICS,
    "mesh/steps/step.SHOWN": PROGRESS,
    "mesh/tsdf.BLOCK": BATCH,
    "pipeline/estimate._RADIUS": PROGRESS,
    "pipeline/novel_view._RIGID": ROUNDING,
    "pipeline/report_pictures.MASKS": PICTURES,
    "pipeline/run_display.LINE_EVERY": PROGRESS,
    "pipeline/steps.SELDOM": PROGRESS,
    "pipeline/stop_signals.INTERRUPTED": MATHEMATICS,
    "segmentation/background.COLUMNS": BATCH,
    "segmentation/background.SAME": MATHEMATICS,
    "segmentation/random_walker.STEPS": MATHEMATICS,
    "shading/ambient_occlusion.TURN": MATHEMATICS,
    "shading/details.GREY": MATHEMATICS,
    "shading/environment_normals.CHUNK": BATCH,
    "shading/flash.CHUNK": BATCH,
    "shading/flash._PAIRS": MATHEMATICS,
    "shading/flash._PLACES": MATHEMATICS,
    "shading/gloss.ROUGHNESSES": SEARCHED,
    "shading/gloss.TILTS": SEARCHED,
    "shading/lighting.BAND": BATCH,
    "shading/lighting.GAMMA": MATHEMATICS,
    "start/masked_surface.FAR_SHADED": PROGRESS,
    "start/masked_surface.FUSED": PROGRESS,
    "start/masked_surface.HALVES_MATCHED": PROGRESS,
    "start/masked_surface.MATCHED": PROGRESS,
    "start/masked_surface.NEAR_BEGUN": PROGRESS,
    "start/masked_surface.NEAR_SHADED": PROGRESS,
    "start/plane_sweep.SWEPT": PROGRESS,
    "start/view_colors._UNSEEN": FORMAT,
    "training/branch.ORDER_EVERY": BATCH,
    "training/checkpoint.FORMAT": FORMAT,
    "training/exposure.DIGITS": FORMAT,
    "training/guard.BLOW_UP_FACTOR": SAFETY,
    "training/guard.BLOW_UP_RISE": SAFETY,
    "training/guard.MOST_BAD_STEPS": SAFETY,
    "training/guard.MOST_INCIDENTS": SAFETY,
    "training/guard.MOST_RETURNS": SAFETY,
    "training/probe.TIMED": PROGRESS,
    "training/probe.UNTIMED": PROGRESS,
    "training/stages.KEPT_NORMALS": BATCH,
    "training/views.MADE_BYTES": BATCH,
}


def constants(path: Path) -> Iterator[str]:
    """Yield the names that a module sets to a number, or to something with a number in it."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        numbers = (part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant))
        if any(isinstance(each, int | float) and not isinstance(each, bool) for each in numbers):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (part.id for each in targets for part in ast.walk(each) if isinstance(part, ast.Name))


def test_no_other_constant_decides_a_result() -> None:
    found = {
        f"{path.relative_to(ROOT).with_suffix('')}.{name}"
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for name in constants(path)
    }
    assert found - REMAINING.keys() == set(), "make it an option of mgsr/config/expert (docs/contributing.md, Numbers)"
    assert REMAINING.keys() - found == set(), "no longer there"
