"""Binary and rough masks, as `benchmarks/masks.py` measures them, and their section of the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mgsr.bench.table import markdown

MASKS = "masks.csv"
EXACT, BINARY, ROUGH = "exact", "binary", "rough"


@dataclass(frozen=True)
class MaskRow:
    """One run with masks that are EXACT, BINARY or ROUGH.

    set: tuning or judging. mask_error: of the scene, in pixels. chamfer: in thousandths of the object's radius.
    normal_error: in degrees. psnr: in dB, of the test views.
    """

    scene: str
    set: str
    masks: str
    mask_error: float
    chamfer: float
    normal_error: float
    psnr: float
    preset: str
    commit: str


def mask_section(rows: Sequence[MaskRow]) -> str:
    """Return the table; empty without rows."""
    if not rows:
        return ""
    cells = [
        [row.scene, row.set, row.masks, f"{row.mask_error:.2f}", f"{row.chamfer:.2f}", f"{row.normal_error:.1f}",
         f"{row.psnr:.2f}"]
        for row in rows
    ]  # fmt: skip
    presets = ", ".join(dict.fromkeys(row.preset for row in rows))
    commits = ", ".join(dict.fromkeys(row.commit for row in rows))
    return "\n\n".join(
        (
            "## Binary and rough masks",
            "Exact masks hold the covered share of each pixel. Binary masks hold 0 or 1. Rough masks are binary, and "
            "their contours err by a pixel, alike over about five pixels. The error is what MGSR measures "
            f"([how](how-it-works.md#inexact-masks)). The preset is {presets}, the program that of {commits}. "
            "`python -m benchmarks.masks` makes these figures.",
            markdown(["scene", "set", "masks", "error in pixels", "Chamfer", "normal error", "PSNR"], cells),
        )
    )
