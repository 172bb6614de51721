"""The part of the evidence page on how long a run trains: what ending earlier saves, and what it costs."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.evidence.comparing import gain, held_against, is_busy, plain_runs
from mgsr.bench.results import Row
from mgsr.bench.table import markdown

SAVED, PSNR_LOST, CHAMFER_LOST = 0.25, 0.1, 0.01  # the share of the time, for at most so many dB and such a share
NO_STOP = "L"
SHORTER = (
    ("warm-ups end by the last 100 losses, as in the published program", "paper-stop"),
    ("half of the mutual phase", "H"),
    ("a quarter of the mutual phase", "G"),
)


@dataclass(frozen=True)
class EarlyEnd:
    """A way to end training earlier, in the mean over some scenes.

    It has the share of the time that it saves, and the dB of PSNR and share of Chamfer that it gives away.
    """

    meaning: str
    scenes: int
    saved: float
    psnr_lost: float
    chamfer_lost: float

    @property
    def pays(self) -> bool:
        """Return whether it saves enough for what it gives away."""
        cheap = round(self.psnr_lost, 2) <= PSNR_LOST and round(self.chamfer_lost, 3) <= CHAMFER_LOST
        return self.saved >= SAVED and cheap

    @property
    def words(self) -> str:
        """Say what it saves and gives away."""
        return f"{self.saved:z.0%} of the time for {self.psnr_lost:z.2f} dB and {self.chamfer_lost:z.1%} of Chamfer"


def early_ends(rows: Sequence[Row]) -> list[EarlyEnd]:
    """Return each way to end earlier that was run on an idle machine, beside runs of its commit that trained on."""
    unstopped = plain_runs(rows, variant=NO_STOP)
    ways = [
        _early_end("warm-ups end by the losses of whole epochs, the default", held_against(unstopped, rows), unstopped)
    ]
    for meaning, name in SHORTER:
        shorter = plain_runs(rows, variant=name)
        ways.append(_early_end(meaning, shorter, held_against(shorter, rows)))
    return [way for way in ways if way is not None]


def length_section(rows: Sequence[Row]) -> str:
    """Return the table of the ways to end earlier, and whether one pays; nothing where none was run."""
    ways = early_ends(rows)
    if not ways:
        return ""
    head = ["what is shortened", "scenes", "time saved", "PSNR lost, dB", "Chamfer lost"]
    cells = [
        [way.meaning, str(way.scenes), f"{way.saved:z.0%}", f"{way.psnr_lost:z.2f}", f"{way.chamfer_lost:z.1%}"]
        for way in ways
    ]
    paying = [way.meaning for way in ways if way.pays]
    verdict = f"This does: {'; '.join(paying)}." if paying else "None does."
    return "\n\n".join(
        (
            "## The length of training",
            f"Shorter training pays if it saves {SAVED:.0%} of the time, mesh extraction included, and loses at "
            f"most {PSNR_LOST} dB and {CHAMFER_LOST:.0%} of Chamfer. The figures are means over the scenes:",
            markdown(head, cells),
            verdict,
        )
    )


def _early_end(meaning: str, shorter: dict[str, Row], longer: dict[str, Row]) -> EarlyEnd | None:
    pairs = [(row, longer[scene]) for scene, row in shorter.items() if scene in longer]
    pairs = [(a, b) for a, b in pairs if not (is_busy(a) or is_busy(b))]
    saved = [1 - a.seconds / b.seconds for a, b in pairs if a.seconds is not None and b.seconds]
    psnr = [gain("psnr", b.psnr, a.psnr) for a, b in pairs if a.psnr is not None and b.psnr is not None]
    chamfer = [a.chamfer / b.chamfer - 1 for a, b in pairs if a.chamfer is not None and b.chamfer]
    if not (saved and psnr and chamfer):
        return None
    return EarlyEnd(meaning, len(pairs), *(statistics.fmean(values) for values in (saved, psnr, chamfer)))
