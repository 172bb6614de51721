"""The stages of a run: what each iteration renders and is judged by. The loop in `trainer.py` runs any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mgsr.config import DensifyConfig, TrainConfig
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.losses.objective import Terms, mutual_terms, surfel_terms, volume_terms
from mgsr.render.outputs import SurfelOutputs, VolumeOutputs
from mgsr.render.surfels import render_surfels
from mgsr.render.volumes import render_volumes
from mgsr.training.branch import Branch
from mgsr.training.convergence import Convergence
from mgsr.training.schedule import sh_degree_at
from mgsr.training.views import Color, TrainingView, ViewCycle, color_tensor

SurfelBranch = Branch[SurfelModel]
VolumeBranch = Branch[VolumeModel]


@dataclass(frozen=True)
class Seen:
    """What densification needs of one render: whose it was, its screen-space figures, its weight in the loss."""

    branch: Branch
    stats: Any
    weight: float


@dataclass(frozen=True)
class Step:
    """One iteration's loss terms, by name and times their weights, and what was seen on the way."""

    terms: Terms
    seen: list[Seen]


@dataclass
class Stage:
    """A stretch of training and where it stands.

    compute renders one view on a background and returns its Step, given the iteration (from 0); window gives the
    first and last iteration of a branch's densification; progress the branch's 0..1 of the whole run.
    """

    name: str
    branches: list[Branch]
    iterations: int
    views: list[TrainingView]
    cycle: ViewCycle
    compute: Callable[[TrainingView, Color, int], Step]
    window: Callable[[DensifyConfig], tuple[float, float]]
    progress: Callable[[Branch, int], float]
    convergence: Convergence | None = None
    iteration: int = 0
    seconds: float = 0.0

    def state(self) -> dict[str, Any]:
        """Where the stage stands, for a checkpoint."""
        return {
            "iteration": self.iteration,
            "seconds": self.seconds,
            "order": self.cycle.order,
            "generator": self.cycle.generator.get_state(),
            "convergence": None if self.convergence is None else self.convergence.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take back what `state` gave."""
        self.iteration, self.seconds = state["iteration"], state["seconds"]
        self.cycle.order = state["order"]
        self.cycle.generator.set_state(state["generator"])
        if self.convergence is not None:
            self.convergence.restore(state["convergence"])


def surfels_alone(branch: SurfelBranch, config: TrainConfig, warming: bool) -> Callable[..., Step]:
    """The 2D branch on the photographs (Algorithm 1); `warming` raises the SH degree and holds back the regularisers
    as the warm-up's settings say."""

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        planned = config.warmup.surfel_iterations
        degree = _degree(iteration, planned, config.surfels.sh_degree, config, warming)
        regularised = not warming or iteration >= config.surfels.regularise_from * planned
        outputs = _see_surfels(branch, view, background, degree, config)
        terms = surfel_terms(outputs, view.target(background), config, regularised)
        return Step(terms, [Seen(branch, outputs.stats, 1.0)])

    return compute


def volumes_alone(branch: VolumeBranch, config: TrainConfig, warming: bool) -> Callable[..., Step]:
    """The 3D branch on the photographs (Algorithm 1); `warming` raises the SH degree."""

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        planned, settings = config.warmup.volume_iterations, config.volumes
        degree = _degree(iteration, planned, settings.sh_degree, config, warming)
        refl_degree = _degree(iteration, planned, settings.reflected_sh_degree, config, warming)
        needs_depth = config.tv and settings.depth_tv_weight > 0
        outputs = _see_volumes(branch, view, background, degree, refl_degree, needs_depth)
        return Step(volume_terms(outputs, view.target(background), config), [Seen(branch, outputs.stats, 1.0)])

    return compute


def both_teach(surfels: SurfelBranch, volumes: VolumeBranch, config: TrainConfig) -> Callable[..., Step]:
    """Both branches on the photographs and on each other (Algorithm 2)."""

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        settings = config.volumes
        flat = _see_surfels(surfels, view, background, config.surfels.sh_degree, config)
        full = _see_volumes(volumes, view, background, settings.sh_degree, settings.reflected_sh_degree, True)
        terms = mutual_terms(flat, full, view.target(background), config)
        seen = [
            Seen(surfels, flat.stats, config.mutual.surfel_weight),
            Seen(volumes, full.stats, config.mutual.volume_weight),
        ]
        return Step(terms, [item for item in seen if item.weight > 0])

    return compute


def _degree(iteration: int, planned: int, highest: int, config: TrainConfig, warming: bool) -> int:
    return sh_degree_at(iteration, planned, config.sh_step, highest) if warming else highest


def _see_surfels(
    branch: SurfelBranch, view: TrainingView, background: Color, degree: int, config: TrainConfig
) -> SurfelOutputs:
    distortion = config.surfels.distortion_weight > 0
    return render_surfels(branch.model, view.camera, color_tensor(background, branch.device), degree, distortion)


def _see_volumes(
    branch: VolumeBranch, view: TrainingView, background: Color, degree: int, refl_degree: int, depth: bool
) -> VolumeOutputs:
    color = color_tensor(background, branch.device)
    return render_volumes(branch.model, view.camera, color, degree, refl_degree, depth)
