"""Options of the time budget (`mgsr.budget`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from mgsr.config.options import Count, NotNegative, Options, Range, Share, WholeNumber


@dataclass(frozen=True)
class BudgetOptions(Options):
    """The plan by which a run fills its time budget.

    A place is one on the line of settings: the preset draft lies at 0, standard at 1 and high at 2.
    """

    aim: Annotated[float, Range(0, 1, open=True)] = 0.96  # planned share of the budget; a run may take 0.9 to 1.05 of
    # the budget
    reserve: NotNegative = 0.5  # share of the surface's expected time that is reserved in case it takes longer; the
    # last stage gets the unused rest
    start_reserve: Annotated[float, Range(1)] = 1.25  # factor on the starting points' usual time, because nothing can
    # shorten their search
    stereo_share: Share = 0.12  # share of the budget for stereo of whole scenes without masks
    min_refined: Share = 0.3  # share of the refinement's time; if less fits the budget, no refinement is planned
    min_pixels: Count = 9216  # least size of a reduced photograph
    below_draft: Annotated[float, Range(0, 2)] = 0.75  # distance of the lowest place below the preset draft; still
    # lower places train too little
    highest: Annotated[float, Range(1, 3)] = 2.0  # highest place; above it, more splats learn the noise
    period: Count = 10  # iterations between two readings of the clock
    readings: Annotated[int, Range(3)] = 5  # number of readings of the clock over which the present speed is measured
    rejected: WholeNumber = 3  # number of candidates that model selection trains and then drops

    @property
    def lowest(self) -> float:
        """Return the lowest place that may be chosen."""
        return -self.below_draft
