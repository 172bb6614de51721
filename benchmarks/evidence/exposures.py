"""Photographs of differing exposure, as `benchmarks/exposures.py` measures them, and their section of the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mgsr.bench.table import markdown

EXPOSURES = "exposures.csv"
EVEN, KEPT, EVENED = "as they are", "exposed differently, kept so", "exposed differently"


@dataclass(frozen=True)
class ExposureRow:
    """One run with photographs of differing exposure.

    photographs: EVEN, KEPT or EVENED; deviation: of the logarithm of light between the photographs. PSNR is in dB, on
    the object, after a gain of each channel; Chamfer in thousandths of the object's radius.
    """

    scene: str
    photographs: str
    deviation: float
    preset: str
    psnr: float
    chamfer: float
    f_score: float
    normal_error: float
    commit: str


def exposure_section(rows: Sequence[ExposureRow]) -> str:
    """Return the table, and how much of the loss is won back; empty without rows."""
    if not rows:
        return ""
    cells = [
        [row.scene, row.photographs, f"{row.psnr:.2f}", f"{row.chamfer:.2f}", f"{row.f_score:.3f}",
         f"{row.normal_error:.1f}"]
        for row in rows
    ]  # fmt: skip
    deviations = " and ".join(sorted({f"{row.deviation:g}" for row in rows if row.deviation}))
    presets = ", ".join(dict.fromkeys(row.preset for row in rows))
    commits = ", ".join(dict.fromkeys(row.commit for row in rows))
    return "\n\n".join(
        (
            "## Photographs of differing exposure",
            "The light of each training photograph was multiplied by a random factor, whose logarithm has the "
            f"standard deviation {deviations}. PSNR is on the object, after one gain per channel, because the "
            f"exposure of the test photographs is arbitrary. The preset is {presets}, the program that of "
            f"{commits}. `python -m benchmarks.exposures` makes these figures.",
            markdown(["scene", "photographs", "PSNR", "Chamfer", "F", "normal error"], cells),
            *_words(rows),
        )
    )


def _words(rows: Sequence[ExposureRow]) -> list[str]:
    by = {(row.scene, row.photographs): row for row in rows}
    scenes = [row.scene for row in rows if row.photographs == EVEN]
    whole = [scene for scene in scenes if (scene, KEPT) in by and (scene, EVENED) in by]
    if not whole:
        return []
    lost, left = (
        sum(by[scene, EVEN].psnr - by[scene, kind].psnr for scene in whole) / len(whole) for kind in (KEPT, EVENED)
    )
    return [f"On average, differing exposures cost {lost:.2f} dB without correction, and {left:.2f} dB with it."]
