"""Comparisons of runs that differ in one thing, scene by scene, put in words."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from mgsr.bench.results import DONE, Row

PRESET = "standard"
BUSY = 0.25  # processors that others keep busy; more, and seconds are not quoted as the program's own

# Each score's name in words, unit, format, and whether less of it is better.
SCORES: dict[str, tuple[str, str, str, bool]] = {
    "psnr": ("PSNR", " dB", ".2f", False),
    "normal_consistency": ("normal consistency", "", ".2f", False),
    "chamfer": ("Chamfer", "", ".2f", True),
    "f_score": ("F", "", ".3f", False),
    "normal_error": ("normal error", "°", ".2f", True),
    "split_gain": ("split gain", " dB", ".2f", False),
    "seconds": ("time", " s", ".0f", True),
}


@dataclass(frozen=True)
class Comparison:
    """One score of two runs on the scenes that both have.

    gains: each scene's, first over second, above zero where the first is better, as the tables round it.
    """

    score: str
    gains: dict[str, float]
    busy: bool

    @property
    def better(self) -> list[str]:
        """Return the scenes on which the first is better."""
        return [scene for scene, gain in self.gains.items() if gain > 0]

    @property
    def worse(self) -> list[str]:
        """Return the scenes on which the first is worse."""
        return [scene for scene, gain in self.gains.items() if gain < 0]

    def words(self) -> str:
        """Describe the mean gain, its range, and on how many scenes the score is better or worse."""
        name, unit, form, _ = SCORES[self.score]
        gains = list(self.gains.values())
        mean, low, high = (f"{value:+z{form}}" for value in (statistics.fmean(gains), min(gains), max(gains)))
        summary = f"{name} better on {len(self.better)}, worse on {len(self.worse)} of {len(gains)} scenes"
        return f"{summary} (mean gain {mean}{unit}, from {low} to {high})"


def plain_runs(rows: Sequence[Row], method: str = "mgsr", variant: str = "", preset: str = PRESET) -> dict[str, Row]:
    """Return the done runs of a method and variant with the lowest seed, on the processor, by scene."""
    found: dict[str, Row] = {}
    for row in sorted(rows, key=lambda row: row.seed):
        if (row.method, row.variant, row.preset, row.device, row.state) == (method, variant, preset, "cpu", DONE):
            found.setdefault(row.scene, row)
    return found


def held_against(own: dict[str, Row], rows: Sequence[Row]) -> dict[str, Row]:
    """Return the method's runs that others are compared with, by scene.

    They are of the same commit, of whatever seed. Scenes without one are left out, since what else changed from commit
    to commit would count as well.
    """
    beside = {scene: plain_runs([row for row in rows if row.commit == run.commit]) for scene, run in own.items()}
    return {scene: runs[scene] for scene, runs in beside.items() if scene in runs}


def compare(first: dict[str, Row], second: dict[str, Row], score: str) -> Comparison | None:
    """Compare a score of two methods' runs scene by scene; None where no scene has the score in both."""
    gains, busy = {}, False
    for scene in first:
        if scene not in second:
            continue
        a, b = getattr(first[scene], score), getattr(second[scene], score)
        if a is not None and b is not None:
            gains[scene] = gain(score, a, b)
            busy |= is_busy(first[scene]) or is_busy(second[scene])
    return Comparison(score, gains, busy) if gains else None


def gain(score: str, first: float, second: float) -> float:
    """Return how much better the first score is than the second, as the tables round both."""
    *_, form, lower_is_better = SCORES[score]
    difference = float(format(first, form)) - float(format(second, form))
    return -difference if lower_is_better else difference


def is_busy(row: Row) -> bool:
    """Return whether others had so much of the machine that the seconds are not the program's own."""
    return "Shared" in row.note if row.others is None else row.others > BUSY


def seed_spread(rows: Sequence[Row], score: str) -> float | None:
    """Return the standard deviation of a score over the seeds of plain runs of one commit, in the mean over scenes.

    None where no scene has two seeds.
    """
    values: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if (row.method, row.variant, row.preset, row.device, row.state) == ("mgsr", "", PRESET, "cpu", DONE):
            values.setdefault((row.scene, row.commit), []).append(getattr(row, score))
    spreads = [statistics.stdev(found) for found in values.values() if len(found) > 1 and None not in found]
    return statistics.fmean(spreads) if spreads else None


def verdict(comparison: Comparison | None, spread: float | None) -> str:
    """Say in a few words whether a finding holds."""
    if comparison is None:
        return "not run"
    mean = statistics.fmean(comparison.gains.values())
    if spread is not None and abs(mean) < spread:
        return "no difference beyond the spread between seeds"
    if not comparison.better and not comparison.worse:
        return "no difference"
    if len(comparison.better) == len(comparison.gains):
        return "holds"
    if not comparison.better:
        return "does not hold"
    return "mixed"
