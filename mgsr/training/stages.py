"""The stages of a run: the renderings and the losses of each iteration.

The loop in `trainer.py` runs any of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor

from mgsr.config import DensifyConfig, Teaching, TrainConfig
from mgsr.data.backdrop import Color
from mgsr.densify.clearance import Clearance
from mgsr.gaussians.environment_map import RenderedMap
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from mgsr.losses.loss import Loss
from mgsr.losses.objective import Terms, environment_map_terms, gaussian_terms, mutual_terms, surfel_terms, total
from mgsr.renderers.environment_map import reflected_environment
from mgsr.renderers.gaussians import render_gaussians
from mgsr.renderers.outputs import GaussianOutputs, SurfelOutputs
from mgsr.renderers.surfels import render_surfels
from mgsr.training.branch import Branch
from mgsr.training.convergence import Convergence
from mgsr.training.environment_map import EnvironmentMapTrainer
from mgsr.training.schedule import sh_degree_at
from mgsr.training.trainable import Trainable
from mgsr.training.views import TrainingView, ViewCycle, color_tensor

SurfelBranch = Branch[SurfelModel]
GaussianBranch = Branch[GaussianModel]
KEPT_NORMALS = 256 * 2**20  # bytes of normals that `ReflectingSurface` may keep


@dataclass(frozen=True)
class RenderStats:
    """The statistics of one render for densification: branch, screen-space statistics, and weight in the loss."""

    branch: Branch[Any]
    stats: Any
    weight: float


@dataclass(frozen=True)
class Step:
    """The loss of one iteration, and the statistics of its renders."""

    loss: Loss
    renders: list[RenderStats]


@dataclass(frozen=True)
class Coarse:
    """Reduced views for the first `share` of a stage's iterations.

    Small images take less time. They suffice while splats still move far.
    """

    views: list[TrainingView]
    share: float


class Growing(Protocol):
    """Something that adapts the splats of one branch to a stage's views (see `mgsr.training.growth`)."""

    @property
    def branch(self) -> Branch[Any]: ...

    def grow(self, views: Sequence[TrainingView]) -> None: ...


class ModelSelection(Protocol):
    """A choice between models in a stage (see `mgsr.training.model_selection`, also for psnr and degrees)."""

    psnr: dict[str, float]
    degrees: dict[int, float]

    def due(self, stage: Stage) -> bool: ...

    def run(self, stage: Stage, train: Callable[[str, int], None]) -> None: ...

    def state(self) -> dict[str, Any]: ...

    def restore(self, state: dict[str, Any], stage: Stage) -> None: ...


@dataclass
class Stage:
    """A stage of training and its progress; a scheduler may change its number of iterations during training.

    branches, environment_map: the models to train.
    compute: renders a view on a background in an iteration, counted from 0, and returns its Step.
    window: returns the first and the last iteration of a branch's densification.
    progress: returns the progress of the whole run, 0..1, for one of its trainables.
    selection: chooses a model during the stage.
    coarse: the smaller views at the start.
    prune: drops splats at the end, and returns their number.
    growth: adapts the splats of a branch without gradient-based densification.
    clearance: the regions to keep free of splats.
    """

    name: str
    branches: list[Branch[Any]]
    iterations: int
    views: list[TrainingView]
    cycle: ViewCycle
    compute: Callable[[TrainingView, Color, int], Step]
    window: Callable[[DensifyConfig], tuple[float, float]]
    progress: Callable[[Trainable[Any], int], float]
    convergence: Convergence | None = None
    environment_map: EnvironmentMapTrainer | None = None
    selection: ModelSelection | None = None
    coarse: Coarse | None = None
    prune: Callable[[], int] | None = None
    growth: Growing | None = None
    clearance: Clearance | None = None
    iteration: int = 0
    seconds: float = 0.0

    @property
    def trainables(self) -> list[Trainable[Any]]:
        """Return all that the stage trains."""
        return [
            *self.branches,
            *([] if self.environment_map is None or not self.environment_map.used else [self.environment_map]),
        ]

    def next_view(self) -> TrainingView:
        """Return the next training view."""
        return self._current_views()[self.cycle.next()]

    def adapt(self, branch: Branch[Any]) -> None:
        """Add splats to a branch of the stage, and prune it."""
        if self.growth is None or self.growth.branch is not branch:
            branch.adapt()
        else:
            self.growth.grow(self._current_views()[: self.cycle.count])
        if self.clearance is not None:
            branch.keep(self.clearance.outside(branch.model.means.detach()))

    def _current_views(self) -> list[TrainingView]:
        if self.coarse is not None and self.iteration < round(self.coarse.share * self.iterations):
            return self.coarse.views
        return self.views

    def state(self) -> dict[str, Any]:
        """Return the stage's progress for a checkpoint."""
        return {
            "iteration": self.iteration,
            "iterations": self.iterations,
            "seconds": self.seconds,
            "order": self.cycle.order,
            "generator": self.cycle.generator.get_state(),
            "convergence": None if self.convergence is None else self.convergence.state(),
            "selection": None if self.selection is None else self.selection.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self.iteration, self.iterations = state["iteration"], state["iterations"]
        self.seconds = state["seconds"]
        self.cycle.order = state["order"]
        self.cycle.generator.set_state(state["generator"])
        if self.convergence is not None:
            self.convergence.restore(state["convergence"])
        if self.selection is not None:
            self.selection.restore(state["selection"], self)


@dataclass(frozen=True)
class ReflectingSurface:
    """The environment map and the surface that reflects it; only the map learns.

    Where the map has no reflector, the 2D branch reflects it. The branch must not change then, because its normals
    are kept as float16, up to KEPT_NORMALS bytes.
    """

    environment_map: EnvironmentMapTrainer
    surfels: SurfelBranch
    kept: dict[tuple[str, int], Tensor] = field(default_factory=dict)  # by the view's name and height

    def shown(self, view: TrainingView, rendered: RenderedMap) -> Tensor:
        """Return the environment map's reflection at each pixel of a view, [H,W,3]."""
        model = self.environment_map.model
        if model.reflector is not None:
            return reflected_environment(model, view.camera, rendered=rendered)
        key = (view.name, view.camera.height)
        normal = self.kept.get(key)
        if normal is None:
            with torch.no_grad():
                normal = render_surfels(self.surfels.model, view.camera).normal.half()
            if (len(self.kept) + 1) * normal.nbytes <= KEPT_NORMALS:
                self.kept[key] = normal
        return reflected_environment(model, view.camera, normal.float(), view.covered, rendered)


def surfels_alone(branch: SurfelBranch, config: TrainConfig, warming: bool) -> Callable[..., Step]:
    """Return a function that computes a step of the 2D branch on the photographs (Algorithm 1).

    warming: whether the stage is the warm-up, whose settings raise the SH degree and delay the regularisers.
    """

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        planned = config.warmup.surfel_iterations
        degree = _degree(iteration, planned, branch.model.sh_degree, config, warming)
        regularised = not warming or iteration >= config.paper.regularise_from * planned
        behind = color_tensor(background, branch.device)
        outputs = _see_surfels(branch, view, behind, degree, config)
        terms = surfel_terms(outputs, view.target(behind), config, regularised)
        return Step(total(terms), [RenderStats(branch, outputs.stats, 1.0)])

    return compute


def gaussians_alone(
    branch: GaussianBranch, config: TrainConfig, warming: bool, surface: ReflectingSurface | None = None
) -> Callable[..., Step]:
    """Return a function that computes a step of the 3D branch on the photographs (Algorithm 1).

    warming: whether the stage is the warm-up, which raises the SH degree. surface: adds the environment map's
    reflection; the 2D branch is frozen.
    """

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        planned = config.warmup.gaussian_iterations
        degree = _degree(iteration, planned, branch.model.sh_degree, config, warming)
        refl_degree = _degree(iteration, planned, branch.model.refl_sh_degree, config, warming)
        needs_depth = config.paper.tv and config.paper.gaussian_depth_tv_weight > 0
        shown: Tensor | None = None
        held: Terms = {}
        if surface is not None and surface.environment_map.used:
            rendered = surface.environment_map.model.rendered()
            shown, held = surface.shown(view, rendered), environment_map_terms(rendered.texels, branch.model, config)
        behind = color_tensor(background, branch.device)
        outputs = _see_gaussians(branch, view, behind, degree, refl_degree, needs_depth, shown)
        terms = gaussian_terms(outputs, view.target(behind), config) | held
        return Step(total(terms), [RenderStats(branch, outputs.stats, 1.0)])

    return compute


def both_teach(
    surfels: SurfelBranch,
    gaussians: GaussianBranch,
    config: TrainConfig,
    environment_map: EnvironmentMapTrainer | None = None,
) -> Callable[..., Step]:
    """Return a function that computes a step of both branches, on the photographs and on each other (Algorithm 2).

    environment_map: the map that the surface reflects. The step trains it if it is used.
    """
    both = config.paper.teaching is Teaching.BOTH_WAYS

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        behind = color_tensor(background, surfels.device)
        flat = _see_surfels(surfels, view, behind, surfels.model.sh_degree, config)
        shown: Tensor | None = None
        held: Terms = {}
        if environment_map is not None and environment_map.used:
            light, normal = environment_map.model, flat.normal if both else flat.normal.detach()
            rendered = light.rendered()
            shown = reflected_environment(light, view.camera, normal, view.covered, rendered)
            held = environment_map_terms(rendered.texels, gaussians.model, config)
        degrees = gaussians.model.sh_degree, gaussians.model.refl_sh_degree
        full = _see_gaussians(gaussians, view, behind, *degrees, True, shown)
        terms = mutual_terms(flat, full, view.target(behind), config) | held
        seen = [
            RenderStats(surfels, flat.stats, config.mutual.surfel_weight),
            RenderStats(gaussians, full.stats, config.mutual.gaussian_weight),
        ]
        return Step(total(terms), [item for item in seen if item.weight > 0])

    return compute


def _degree(iteration: int, planned: int, highest: int, config: TrainConfig, warming: bool) -> int:
    return sh_degree_at(iteration, planned, config.sh_step, highest) if warming else highest


def _see_surfels(
    branch: SurfelBranch, view: TrainingView, behind: Tensor, degree: int, config: TrainConfig
) -> SurfelOutputs:
    """Render the surfels of a training view on a background [H,W,3] or [3], with the stage's options."""
    distortion = config.paper.distortion_weight > 0
    return render_surfels(branch.model, view.camera, behind, degree, distortion, view.shading())


def _see_gaussians(
    branch: GaussianBranch,
    view: TrainingView,
    behind: Tensor,
    degree: int,
    refl_degree: int,
    depth: bool,
    environment: Tensor | None,
) -> GaussianOutputs:
    """Render the 3D branch from a view's camera; behind [3]: the background; environment [H,W,3] or None."""
    light = (environment, view.shading())
    return render_gaussians(branch.model, view.camera, behind, degree, refl_degree, depth, *light)
