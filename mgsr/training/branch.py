"""One branch in training: its splats, and their densification."""

from __future__ import annotations

from typing import Any, TypeVar

import torch
from torch import Tensor

from mgsr.config import DensifyConfig, RatesConfig
from mgsr.densify.adaptive import adapt, lowered_opacities
from mgsr.densify.state import DensifyState
from mgsr.errors import TrainingError
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.order import morton_order
from mgsr.gaussians.surfels import SurfelModel
from mgsr.ops.adam import FusedAdam
from mgsr.training.schedule import SH_NAMES, rates_at, rest_scale
from mgsr.training.trainable import Trainable

Splats = TypeVar("Splats", bound=SurfelModel | GaussianModel)
# Steps after which the next densification sorts splats on a GPU again. Neighbours in space should be neighbours in
# memory, so that reads are coalesced.
ORDER_EVERY = 2000


class Branch(Trainable[Splats]):
    """A branch's splats with everything that changes them.

    `name` is surfels or gaussians; extent: the scene's, in its unit.
    """

    def __init__(
        self,
        name: str,
        model: Splats,
        rates: RatesConfig,
        densify: DensifyConfig,
        extent: float,
        generator: torch.Generator,
    ) -> None:
        self.settings = rates
        self.densify = densify
        self.extent = extent
        self.generator = generator
        super().__init__(name, model)
        self.densify_state = DensifyState.empty(len(model), self.device)

    def rates(self, progress: float) -> dict[str, float]:
        """Return the learning rates by parameter at `progress` 0..1 of the run (see `Trainable`)."""
        return rates_at(progress, self.settings, self.extent)

    def make_optimizer(self, parameters: dict[str, Tensor]) -> FusedAdam:
        """Return a new optimiser for the branch's parameters [N,...] (see `Trainable`)."""
        return FusedAdam(
            parameters,
            {name: rate for name, rate in self.rates(0.0).items() if name in parameters},
            lr_scales={name: rest_scale(parameters[name], self.settings) for name in SH_NAMES if name in parameters},
            betas=(self.settings.beta1, self.settings.beta2),
            epsilon=self.settings.eps,
        )

    def gather(self, stats: Any, width: int, height: int, weight: float, bad: Tensor | None = None) -> None:
        """Gather one image's screen-space gradients [N,2] for densification (see `DensifyState.gather`)."""
        if stats.v_means2d is not None:
            self.densify_state.gather(stats.v_means2d, stats.radii, width, height, weight, bad)

    def adapt(self, grow: bool = True) -> None:
        """Clone, split and prune splats, and reset the gathered statistics.

        Raises TrainingError when no splat is left.
        """
        change = adapt(self.model.parameters(), self.densify_state, self.densify, self.extent, self.generator, grow)
        if len(change.kept) + change.cloned + 2 * change.split == 0:
            raise TrainingError(
                f"{self.name}: every splat was pruned, so no splat explains the images; check the poses and masks, or "
                "lower prune_opacity"
            )
        self.exchange(change.kept, change.added)
        if self.device.type != "cpu" and self.steps % ORDER_EVERY < self.densify.every:
            self.reorder()

    def reorder(self) -> None:
        """Put neighbours in space next to each other in memory (`morton_order`).

        Call it only while no gradients are gathered, as these keep the old order.
        """
        self.optimizer.keep(morton_order(self.model.means.detach()))
        self.adopt()

    def exchange(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep some splats, append new ones, and reset the gathered statistics.

        kept [M] int64: the ascending indices to keep; added: the new splats' tensors, by name, as the model's.
        """
        self.optimizer.keep(kept)
        self.optimizer.extend(added)
        self.adopt()
        self.densify_state = DensifyState.empty(len(self.model), self.device)

    def keep(self, rows: Tensor) -> None:
        """Keep only the splats of ascending indices [M] int64, and reset the gathered statistics."""
        self.optimizer.keep(rows)
        self.adopt()
        self.densify_state = DensifyState.empty(len(self.model), self.device)

    def reset_opacities(self) -> None:
        """Lower every opacity and forget the optimiser's momentum there."""
        for name, lowered in lowered_opacities(self.model.parameters(), self.densify.reset_opacity).items():
            self.optimizer.replace(name, lowered)

    def state(self) -> dict[str, Any]:
        """Return everything that the next iteration depends on, for a checkpoint."""
        return super().state() | {"densify": self.densify_state.tensors(), "generator": self.generator.get_state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        super().restore(state)
        self.densify_state = DensifyState(**state["densify"]).to(self.device)
        self.generator.set_state(state["generator"])
