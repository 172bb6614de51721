"""The shared environment maps in training."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from mgsr.config import EnvironmentMapConfig
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.ops.adam import FusedAdam
from mgsr.training.schedule import decay
from mgsr.training.trainable import Trainable


class EnvironmentMapTrainer(Trainable[EnvironmentMap]):
    """The environment maps that the surface reflects, with their optimiser.

    `used` says whether they are part of the model.
    """

    def __init__(self, model: EnvironmentMap, config: EnvironmentMapConfig, used: bool) -> None:
        self.settings = config
        self.used = used
        super().__init__("environment_map", model)

    def rates(self, progress: float) -> dict[str, float]:
        """Return the learning rates by parameter at `progress` 0..1 of the run (see `Trainable`)."""
        return {"logits": self.settings.rate * decay(progress, self.settings.decay_from, self.settings.final_factor)}

    def make_optimizer(self, parameters: dict[str, Tensor]) -> FusedAdam:
        """Return a new optimiser for the maps [2,S,S,3] (see `Trainable`)."""
        return FusedAdam(parameters, self.rates(0.0))

    def state(self) -> dict[str, Any]:
        """Return everything that the next step depends on, for a checkpoint."""
        return super().state() | {"used": self.used}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        super().restore(state)
        self.used = state["used"]
