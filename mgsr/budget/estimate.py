"""The seconds and the memory that a run will take, from the cost model of time budgets."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.budget import costs
from mgsr.budget.budget import reference_training
from mgsr.config import Config
from mgsr.data.cost_factors import CostFactors

# MiB, fitted to the CPU runs of benchmarks/results/runs.csv: of the program with its libraries, of a million pixels of
# photographs, of each doubling of the surface's octree beyond the preset draft, and of 1,000 splats beyond the preset
# standard.
_PROGRAM, _PHOTOGRAPHS, _SURFACE, _SPLATS = 880.0, 33.0, 550.0, 6.0
_DRAFT_DEPTH, _USUAL_SPLATS = 7, 30_000


@dataclass(frozen=True)
class Speed:
    """The time that this machine takes, as a multiple of the reference machine's.

    training: for iterations of training, which may run on a GPU. rest: for all other work.
    """

    training: float
    rest: float


@dataclass(frozen=True)
class Estimate:
    """The expected time and memory of a run at a preset. seconds: the whole run; steps: seconds by step."""

    preset: str
    seconds: float
    memory_mib: float
    steps: dict[str, float]


def estimate_run(preset: str, factors: CostFactors, config: Config, speed: Speed, before: dict[str, float]) -> Estimate:
    """Return the estimate of a run with these settings. before: measured seconds of the steps that need no estimate."""
    steps = before | {
        "start": speed.rest * costs.start_cost(factors, config.expert.start.stereo.max_pixels),
        "train": speed.training * reference_training(factors, config),
        "mesh": speed.rest * costs.mesh_cost(factors, config.mesh, refined=1.0),
        "evaluate": speed.rest * costs.judging_cost(factors),
        "report": speed.rest * costs.closing_cost(factors),
    }
    rounded = {name: round(seconds, 1) for name, seconds in steps.items()}
    return Estimate(preset, round(sum(steps.values()), 1), round(memory_mib(factors, config)), rounded)


def memory_mib(factors: CostFactors, config: Config) -> float:
    """Return the most memory, MiB, that the process of a run on the CPU will hold."""
    photographs = (factors.views + factors.tests) * factors.pixels / 1e6
    surface = _SURFACE * max(0.0, 2.0 ** (config.mesh.poisson_depth - _DRAFT_DEPTH) - 1)
    surfels, gaussians = costs.usual_settings(factors, config)
    splats = surfels.densify.max_count + gaussians.max_start
    extra = max(0, splats - _USUAL_SPLATS) / 1000
    return _PROGRAM + _PHOTOGRAPHS * photographs + surface + _SPLATS * extra
