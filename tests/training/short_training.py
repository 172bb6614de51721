"""A training of some seconds, and what it learnt; no reader of scenes or meshes is needed for it."""

from __future__ import annotations

import torch

from mgsr.config import Config, make_config
from mgsr.training.progress import TrainResult

SHORT = [
    "warmup.surfel_iterations=24",
    "warmup.gaussian_iterations=24",
    "mutual.iterations=12",
    "surfels.densify.every=8",
    "gaussians.densify.every=8",
    "gradient_threshold=1e-5",
    "mutual_stop=0.8",
    "stop_rule=none",
    "curve_every=20",
    "check_every=5",
    "coarse_side=16",
]


def short(method: str = "mgsr", *overrides: str) -> Config:
    """Return the settings of a training of some seconds."""
    both = [item for key in SHORT for item in _each_branch(key)]
    return make_config("draft", method, 0, [*both, *overrides])


def _each_branch(override: str) -> list[str]:
    shared = ("gradient_threshold", "mutual_stop", "reset_every", "prune_opacity")
    if override.startswith(shared):
        return [f"{branch}.densify.{override}" for branch in ("surfels", "gaussians")]
    return [override]


def tensors(result: TrainResult) -> dict[str, torch.Tensor]:
    """Return all that was learnt, by the model's and the tensor's name."""
    models = {
        "surfels": result.model.surfels,
        "gaussians": result.model.gaussians,
        "environment_map": result.model.environment_map,
    }
    return {
        f"{name}.{key}": tensor
        for name, model in models.items()
        if model is not None
        for key, tensor in model.parameters().items()
    }


def assert_same(first: TrainResult, second: TrainResult) -> None:
    """Assert that two trainings learnt the same, to the bit."""
    one, two = tensors(first), tensors(second)
    assert one.keys() == two.keys()
    for name in one:
        assert torch.equal(one[name], two[name]), name
