"""One branch in training: its model, optimiser, densification and what it renders."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Generic, Literal, TypeVar

import torch
from torch import Tensor

from mgsr.config import DensifyConfig, RatesConfig
from mgsr.densify.adaptive import adapt
from mgsr.densify.reset import lowered_opacities
from mgsr.densify.state import DensifyState
from mgsr.errors import TrainingError
from mgsr.gaussians.order import morton_order
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.ops.adam import FusedAdam
from mgsr.training.schedule import SH_NAMES, rates_at, rest_scale

Model = TypeVar("Model", SurfelModel, VolumeModel)
Kind = Literal["values", "grad"]  # a parameter's numbers, or its gradient's
# Steps after which splats on a card are put in order again, at the next densification: neighbours in memory are read
# together there.
ORDER_EVERY = 2000


class Branch(Generic[Model]):
    """A model with everything that changes it. `name` is surfels or volumes; extent: the scene's, in its unit."""

    def __init__(
        self,
        name: str,
        model: Model,
        rates: RatesConfig,
        densify: DensifyConfig,
        extent: float,
        generator: torch.Generator,
    ) -> None:
        self.name = name
        self.model: Model = model
        self.rates = rates
        self.densify = densify
        self.extent = extent
        self.generator = generator
        self.steps = 0
        self.optimizer = self._make_optimizer(model.parameters())
        self.densify_state = DensifyState.empty(len(model), self.device)
        self._adopt()

    @property
    def device(self) -> torch.device:
        """Where the splats are."""
        return self.model.means.device

    def step(self, progress: float) -> None:
        """One step of the optimiser along the gradients that backward has left; `progress` 0..1 of the run."""
        rates = rates_at(progress, self.rates, self.extent)
        for name in self.optimizer.params:
            self.optimizer.set_lr(name, rates[name])
        self.optimizer.step()
        for tensor in self.optimizer.params.values():
            tensor.grad = None
        self.steps += 1

    def gather(self, stats: Any, width: int, height: int, weight: float) -> None:
        """Note one image's screen-space gradients for densification (see `DensifyState.gather`)."""
        if stats.v_means2d is not None:
            self.densify_state.gather(stats.v_means2d, stats.radii, width, height, weight)

    def adapt(self, grow: bool = True) -> None:
        """Clone, split and prune, and begin to gather anew. Raises TrainingError when no splat is left."""
        change = adapt(self.model.parameters(), self.densify_state, self.densify, self.extent, self.generator, grow)
        if len(change.kept) + change.cloned + 2 * change.split == 0:
            raise TrainingError(
                f"{self.name}: every splat was pruned, so nothing of the images was explained; check the poses and "
                "masks, or lower prune_opacity"
            )
        self.optimizer.keep(change.kept)
        self.optimizer.extend(change.added)
        self._adopt()
        self.densify_state = DensifyState.empty(len(self.model), self.device)
        if self.device.type != "cpu" and self.steps % ORDER_EVERY < self.densify.every:
            self.reorder()

    def reorder(self) -> None:
        """Put neighbours in space next to each other in memory. For when nothing is gathered of the splats."""
        self.optimizer.keep(morton_order(self.model.means.detach()))
        self._adopt()

    def reset_opacities(self) -> None:
        """Lower every opacity and forget the optimiser's momentum there."""
        for name, lowered in lowered_opacities(self.model.parameters(), self.densify.reset_opacity).items():
            self.optimizer.replace(name, lowered)

    def skip_step(self) -> None:
        """Forget the gradients that backward has left; counts as a step, so that the schedule goes on."""
        for tensor in self.optimizer.params.values():
            tensor.grad = None
        self.steps += 1

    def tensors(self, kind: Kind) -> dict[str, Tensor]:
        """The parameters' values, or the gradients of those that have one, by name."""
        if kind == "values":
            return {name: tensor.detach() for name, tensor in self.optimizer.params.items()}
        return {name: tensor.grad for name, tensor in self.optimizer.params.items() if tensor.grad is not None}

    def bad(self, kind: Kind) -> list[str]:
        """Names of the parameters whose value, or gradient, is not finite or has a square that is not."""
        tensors = self.tensors(kind).items()
        return [f"{self.name}.{name}" for name, tensor in tensors if not bool(tensor.square().sum().isfinite())]

    def state(self) -> dict[str, Any]:
        """Everything that the next iteration depends on, for a checkpoint."""
        return {
            "parameters": {name: tensor.detach() for name, tensor in self.optimizer.params.items()},
            "optimizer": self.optimizer.state_dict(),
            "densify": self.densify_state.tensors(),
            "generator": self.generator.get_state(),
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take back what `state` gave."""
        device = self.device
        self.optimizer = self._make_optimizer({name: t.to(device) for name, t in state["parameters"].items()})
        self.optimizer.load_state_dict(state["optimizer"])
        self.densify_state = DensifyState(**state["densify"]).to(device)
        self.generator.set_state(state["generator"])
        self.steps = state["steps"]
        self._adopt()

    def _make_optimizer(self, parameters: dict[str, Tensor]) -> FusedAdam:
        return FusedAdam(
            parameters,
            {name: rate for name, rate in rates_at(0.0, self.rates, self.extent).items() if name in parameters},
            lr_scales={name: rest_scale(parameters[name], self.rates) for name in SH_NAMES if name in parameters},
            betas=(self.rates.beta1, self.rates.beta2),
            epsilon=self.rates.eps,
        )

    def _adopt(self) -> None:
        """Let the model's fields be the optimiser's tensors, which it replaces when their number changes."""
        for item in fields(self.model):
            setattr(self.model, item.name, self.optimizer.params.get(item.name))
