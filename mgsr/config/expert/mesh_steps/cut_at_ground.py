"""Options of the step `cut_at_ground`."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.config.options import NotNegative, Options


@dataclass(frozen=True)
class CutAtGroundOptions(Options):
    """The cut at the plane on which a found object stands."""

    sunk: NotNegative = 1.0  # footprints; depth below the plane up to which the surface is kept
