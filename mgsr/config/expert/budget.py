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

    aim: Annotated[float, Range(0, 1, open=True)] = 0.96  # planned share of the budget; a run may take 0.9 to 1.05
    reserve: NotNegative = 0.5  # for a slower surface, as a share of its time; the last stage gets what is left of it
    start_reserve: Annotated[float, Range(1)] = 1.25  # times the starting points' usual time, which nothing can cut
    stereo_share: Share = 0.12  # of the budget, for stereo of everything in view without masks
    min_refined: Share = 0.3  # of the refinement's time, with less of which the refinement is not planned
    min_pixels: Count = 9216  # least size of a reduced photograph
    below_draft: Annotated[float, Range(0, 2)] = 0.75  # places below draft, beyond which too little is trained
    highest: Annotated[float, Range(1, 3)] = 2.0  # place above which more splats learn the noise
    period: Count = 10  # iterations between two readings of the clock
    readings: Annotated[int, Range(3)] = 5  # over which the present speed is measured
    rejected: WholeNumber = 3  # candidates of a model selection that are trained and then dropped

    @property
    def lowest(self) -> float:
        """Return the lowest place that may be chosen."""
        return -self.below_draft
