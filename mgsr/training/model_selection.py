"""Model selection of the 3D branch: a part must earn its place on photographs that training did not see.

It chooses the branch's reflection model and the harmonic degree of the transmitted light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mgsr.config import Reflection, TrainConfig
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.start import reflected_half
from mgsr.training.branch import Branch
from mgsr.training.environment_map import EnvironmentMapTrainer
from mgsr.training.stages import Stage
from mgsr.training.trainable import copied

# From the simplest to the one with the most parameters. `Reflection.BOTH` is no candidate. On shiny objects it gains
# less than the shared light alone. On matte objects it gains only by its additional parameters.
CANDIDATES = (Reflection.OFF, Reflection.SHARED)
CANDIDATES_ALONE = (Reflection.OFF, Reflection.OWN)  # without a surface that reflects

Train = Callable[[str, int], None]  # trains the stage as the named candidate, for a number of iterations


@dataclass(frozen=True)
class Candidate:
    """A model that was tried: its reflection, degree, PSNR in dB, and state."""

    reflection: Reflection
    sh_degree: int
    psnr: float
    state: dict[str, Any]


class ReflectionSelection:
    """Trains each candidate from the same state and on the same views, and keeps the best.

    It first tries the reflection models, with all degrees of the transmitted colour's harmonics. It then lowers the
    degree step by step while the result is no worse.

    environment_map: None where no surface reflects it.
    measure: returns the 3D branch's PSNR, dB, on photographs that the stage is not trained on.
    all_views: how many of the stage's first views training may use after the selection.
    psnr, degrees: the PSNR, dB, of each reflection model and of each lower degree; empty before the selection.
    """

    def __init__(
        self,
        config: TrainConfig,
        branch: Branch[GaussianModel],
        environment_map: EnvironmentMapTrainer | None,
        measure: Callable[[], float],
        all_views: int,
    ) -> None:
        self.settings, self.gaussians = config.model_selection, config.gaussians
        self.branch, self.environment_map = branch, environment_map
        self.measure = measure
        self.all_views = all_views
        self.chosen: Reflection | None = None
        self.psnr: dict[str, float] = {}
        self.degrees: dict[int, float] = {}

    def due(self, stage: Stage) -> bool:
        """Return whether it is time for the selection; a scheduler may change the stage's length until then."""
        return self.chosen is None and stage.iteration >= round(self.settings.start * stage.iterations)

    def run(self, stage: Stage, train: Train) -> None:
        """Try all candidates, and keep the best.

        Whatever `train` raises leaves the selection undecided.
        """
        before, highest = copied(self._state(stage)), self.branch.model.sh_degree
        kinds = CANDIDATES_ALONE if self.environment_map is None else CANDIDATES
        tried = [self._try(stage, train, before, kind, highest) for kind in kinds]
        best = simplest(tried, self.settings.gain)
        lower: list[Candidate] = []
        for degree in reversed(range(best.sh_degree)):
            lower.append(self._try(stage, train, before, best.reflection, degree))
            # A model with fewer parameters trains faster. If it is slightly behind now, it would be further behind
            # at the end.
            if lower[-1].psnr < best.psnr:
                break
            best = lower[-1]
        self._restore(stage, best.state)
        self.psnr = {str(each.reflection): each.psnr for each in tried}
        self.degrees = {each.sh_degree: each.psnr for each in lower}
        self._decide(stage, best.reflection)

    def state(self) -> dict[str, Any]:
        """Return the decisions for a checkpoint."""
        chosen = None if self.chosen is None else str(self.chosen)
        return {"chosen": chosen, "psnr": self.psnr, "degrees": self.degrees}

    def restore(self, state: dict[str, Any], stage: Stage) -> None:
        """Restore what `state` returned."""
        self.psnr, self.degrees = state["psnr"], state["degrees"]
        if state["chosen"] is not None:
            self._decide(stage, Reflection(state["chosen"]))

    def _try(
        self, stage: Stage, train: Train, before: dict[str, Any], reflection: Reflection, sh_degree: int
    ) -> Candidate:
        self._restore(stage, before)
        lowered = sh_degree < self.branch.model.sh_degree
        self._add(reflection)
        if lowered:
            self.branch.narrow("sh", (sh_degree + 1) ** 2)
        iterations = min(self.settings.iterations, stage.iterations - stage.iteration)
        train(f"degree_{sh_degree}" if lowered else str(reflection), iterations)
        return Candidate(reflection, sh_degree, self.measure(), copied(self._state(stage)))

    def _decide(self, stage: Stage, reflection: Reflection) -> None:
        self.chosen = reflection
        stage.cycle.count = self.all_views

    def _add(self, reflection: Reflection) -> None:
        """Add the candidate's missing parameters to the models."""
        if self.environment_map is not None:
            self.environment_map.used = reflection is not Reflection.OFF
        if reflection in (Reflection.OWN, Reflection.BOTH):
            self.branch.widen(reflected_half(self.branch.model, self.gaussians))

    def _state(self, stage: Stage) -> dict[str, Any]:
        return {"stage": stage.state(), "trainables": {each.name: each.state() for each in self._trainables()}}

    def _restore(self, stage: Stage, state: dict[str, Any]) -> None:
        state = copied(state)
        stage.restore(state["stage"])
        for each in self._trainables():
            each.restore(state["trainables"][each.name])

    def _trainables(self) -> list[Branch[GaussianModel] | EnvironmentMapTrainer]:
        return [self.branch, *([] if self.environment_map is None else [self.environment_map])]


def simplest(tried: list[Candidate], gain: float) -> Candidate:
    """Choose the candidate with the best PSNR, unless a simpler one is nearly as good.

    tried: in the order from the simplest. A later candidate replaces the chosen one only if its PSNR is more than
    `gain` dB higher.
    """
    best = tried[0]
    for candidate in tried[1:]:
        if candidate.psnr > best.psnr + gain:
            best = candidate
    return best
