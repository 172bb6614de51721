"""Trainable models: parameters with their optimiser, and their state for a checkpoint."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, Literal, TypeVar

import torch
from torch import Tensor

from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from mgsr.ops.adam import FusedAdam, step_together

Model = TypeVar("Model", bound=SurfelModel | GaussianModel | EnvironmentMap)
Kind = Literal["values", "grad"]  # a parameter's numbers, or its gradient's


class Trainable(ABC, Generic[Model]):
    """A model and its optimiser, which owns the model's tensors.

    `name` is unique in a run. All learning rates are multiplied by `rate_scale`.
    """

    def __init__(self, name: str, model: Model) -> None:
        self.name = name
        self.model: Model = model
        self.steps = 0
        self.rate_scale = 1.0
        self.optimizer = self.make_optimizer(model.parameters())
        self.adopt()

    @abstractmethod
    def rates(self, progress: float) -> dict[str, float]:
        """Return each parameter's learning rate at `progress` 0..1 of the run; other names may be included."""

    @abstractmethod
    def make_optimizer(self, parameters: dict[str, Tensor]) -> FusedAdam:
        """Return a new optimiser for the model's parameters [N,...]."""

    @property
    def device(self) -> torch.device:
        """Return the device of the parameters."""
        return next(iter(self.optimizer.params.values())).device

    def skip_step(self) -> None:
        """Clear the gradients, and count a step, so that the schedule continues."""
        for tensor in self.optimizer.params.values():
            tensor.grad = None
        self.steps += 1

    def tensors(self, kind: Kind) -> dict[str, Tensor]:
        """Return by name the parameters' values, or their gradients [same shapes] where they exist."""
        if kind == "values":
            return {name: tensor.detach() for name, tensor in self.optimizer.params.items()}
        return {name: tensor.grad for name, tensor in self.optimizer.params.items() if tensor.grad is not None}

    def bad(self, kind: Kind) -> list[str]:
        """Return the names of the parameters whose value or gradient, or its square, is not finite."""
        tensors = self.tensors(kind).items()
        return [f"{self.name}.{name}" for name, tensor in tensors if not bool(tensor.square().sum().isfinite())]

    def state(self) -> dict[str, Any]:
        """Return everything that the next step depends on, for a checkpoint."""
        return {
            "parameters": {name: tensor.detach() for name, tensor in self.optimizer.params.items()},
            "optimizer": self.optimizer.state_dict(),
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        device = self.device
        self.optimizer = self.make_optimizer({name: t.to(device) for name, t in state["parameters"].items()})
        self.optimizer.load_state_dict(state["optimizer"])
        self.steps = state["steps"]
        self.adopt()

    def widen(self, added: dict[str, Tensor]) -> None:
        """Add parameters [N,...] to the model, by name; the optimiser keeps the other parameters' moments."""
        state = copied(self.state())
        state["parameters"] |= added
        moments = state["optimizer"]
        for kind in ("first", "second"):
            moments[kind] |= {name: torch.zeros_like(tensor) for name, tensor in added.items()}
        moments["steps"] |= dict.fromkeys(added, 0)
        moments["lrs"] |= {name: self.rates(0.0)[name] for name in added}
        self.restore(state)

    def narrow(self, name: str, columns: int) -> None:
        """Keep the first columns [N,columns,...] of a parameter, with their moments."""
        state = copied(self.state())
        for tensors in (state["parameters"], state["optimizer"]["first"], state["optimizer"]["second"]):
            tensors[name] = tensors[name][:, :columns].contiguous()
        self.restore(state)

    def adopt(self) -> None:
        """Point the model's fields at the optimiser's tensors, which it replaces when the number of splats changes."""
        for name in self.model.parameters() | self.optimizer.params:
            setattr(self.model, name, self.optimizer.params.get(name))


def step_trainables(progress: Mapping[Trainable[Any], float], bad: Tensor | None = None) -> None:
    """Take one optimiser step of all these models, on a GPU in one launch.

    progress: the share, 0..1, of the run that is done, for each model. bad [] bool, on a GPU: whether to treat the
    gradients as zero.
    """
    for part, share in progress.items():
        part.optimizer.set_lrs({name: part.rate_scale * rate for name, rate in part.rates(share).items()})
    step_together([part.optimizer for part in progress], bad)
    for part in progress:
        part.skip_step()


def copied(state: Any) -> Any:
    """Copy a state of nested dicts and lists, and clone its tensors."""
    if isinstance(state, dict):
        return {name: copied(value) for name, value in state.items()}
    if isinstance(state, list):
        return [copied(value) for value in state]
    return state.clone() if isinstance(state, Tensor) else state
