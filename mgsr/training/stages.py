"""The stages of a run: what each iteration renders, and by what it is judged.

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
from mgsr.gaussians.mirrored import Light
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.volumes import VolumeModel
from mgsr.losses.loss import Loss
from mgsr.losses.mirrored import light_terms
from mgsr.losses.objective import Terms, mutual_terms, surfel_terms, total, volume_terms
from mgsr.renderers.mirrored import mirrored_light
from mgsr.renderers.outputs import SurfelOutputs, VolumeOutputs
from mgsr.renderers.surfels import render_surfels
from mgsr.renderers.volumes import render_volumes
from mgsr.training.branch import Branch
from mgsr.training.convergence import Convergence
from mgsr.training.light import LightInTraining
from mgsr.training.schedule import sh_degree_at
from mgsr.training.trained import Trained
from mgsr.training.views import TrainingView, ViewCycle, color_tensor

SurfelBranch = Branch[SurfelModel]
VolumeBranch = Branch[VolumeModel]
KEPT_NORMALS = 256 * 2**20  # bytes


@dataclass(frozen=True)
class Seen:
    """What densification needs of one render: its branch, its screen-space figures and its weight in the loss."""

    branch: Branch[Any]
    stats: Any
    weight: float


@dataclass(frozen=True)
class Step:
    """One iteration's loss, and what densification needs of its renders."""

    loss: Loss
    seen: list[Seen]


@dataclass(frozen=True)
class Coarse:
    """A stage's views made smaller, for the first `share` of its iterations.

    While splats find their places, small images say as much, in less time.
    """

    views: list[TrainingView]
    share: float


class Growing(Protocol):
    """Something that adapts the splats of one branch to a stage's views (see `mgsr.training.growth`)."""

    @property
    def branch(self) -> Branch[Any]: ...

    def grow(self, views: Sequence[TrainingView]) -> None: ...


class Trial(Protocol):
    """Something that is decided in a stage by trying (see `mgsr.training.trial`, also for psnr and degrees)."""

    psnr: dict[str, float]
    degrees: dict[int, float]

    def due(self, stage: Stage) -> bool: ...

    def hold(self, stage: Stage, run: Callable[[str, int], None]) -> None: ...

    def state(self) -> dict[str, Any]: ...

    def restore(self, state: dict[str, Any], stage: Stage) -> None: ...


@dataclass
class Stage:
    """A stretch of training and where it stands; a pace may change its iterations on the way.

    branches: those that it trains; light: what it trains beside them. compute renders one view on a background and
    returns its Step, given the iteration (from 0); window gives the first and last iteration of a branch's
    densification; progress 0..1 of the whole run, for a part of what is trained. trial: what is decided on the way;
    coarse: how it begins; thin: how it ends, by dropping splats, whose number it returns; growth: what adapts the
    splats of a branch that does not go by the gradient; clearance: where no splats may be.
    """

    name: str
    branches: list[Branch[Any]]
    iterations: int
    views: list[TrainingView]
    cycle: ViewCycle
    compute: Callable[[TrainingView, Color, int], Step]
    window: Callable[[DensifyConfig], tuple[float, float]]
    progress: Callable[[Trained[Any], int], float]
    convergence: Convergence | None = None
    light: LightInTraining | None = None
    trial: Trial | None = None
    coarse: Coarse | None = None
    thin: Callable[[], int] | None = None
    growth: Growing | None = None
    clearance: Clearance | None = None
    iteration: int = 0
    seconds: float = 0.0

    @property
    def trained(self) -> list[Trained[Any]]:
        """Return all that the stage trains."""
        return [*self.branches, *([] if self.light is None or not self.light.used else [self.light])]

    def next_view(self) -> TrainingView:
        """Return the view whose turn it is."""
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
        """Return where the stage stands, for a checkpoint."""
        return {
            "iteration": self.iteration,
            "iterations": self.iterations,
            "seconds": self.seconds,
            "order": self.cycle.order,
            "generator": self.cycle.generator.get_state(),
            "convergence": None if self.convergence is None else self.convergence.state(),
            "trial": None if self.trial is None else self.trial.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self.iteration, self.iterations = state["iteration"], state["iterations"]
        self.seconds = state["seconds"]
        self.cycle.order = state["order"]
        self.cycle.generator.set_state(state["generator"])
        if self.convergence is not None:
            self.convergence.restore(state["convergence"])
        if self.trial is not None:
            self.trial.restore(state["trial"], self)


@dataclass(frozen=True)
class WhatIsMirrored:
    """The environment maps that the surface mirrors, and the surface that mirrors them; only the maps learn.

    Where the light has no reflector, the 2D branch's normals mirror it. The branch must stand still then, for its
    normals are kept, as float16, while KEPT_NORMALS lasts.
    """

    light: LightInTraining
    surfels: SurfelBranch
    kept: dict[tuple[str, int], Tensor] = field(default_factory=dict)  # by the view's name and height

    def shown(self, view: TrainingView, shining: Light) -> Tensor:
        """Return what each pixel of a view mirrors of the light, [H,W,3]."""
        model = self.light.model
        if model.reflector is not None:
            return mirrored_light(model, view.camera, pixels=view.covered, shining=shining)
        key = (view.name, view.camera.height)
        normal = self.kept.get(key)
        if normal is None:
            with torch.no_grad():
                normal = render_surfels(self.surfels.model, view.camera).normal.half()
            if (len(self.kept) + 1) * normal.nbytes <= KEPT_NORMALS:
                self.kept[key] = normal
        return mirrored_light(model, view.camera, normal.float(), view.covered, shining)


def surfels_alone(branch: SurfelBranch, config: TrainConfig, warming: bool) -> Callable[..., Step]:
    """Return a function that computes a step of the 2D branch on the photographs (Algorithm 1).

    `warming` raises the SH degree and holds back the regularisers as the warm-up's settings say.
    """

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        planned = config.warmup.surfel_iterations
        degree = _degree(iteration, planned, branch.model.sh_degree, config, warming)
        regularised = not warming or iteration >= config.surfels.regularise_from * planned
        behind = color_tensor(background, branch.device)
        outputs = _see_surfels(branch, view, behind, degree, config)
        terms = surfel_terms(outputs, view.target(behind), config, regularised)
        return Step(total(terms), [Seen(branch, outputs.stats, 1.0)])

    return compute


def volumes_alone(
    branch: VolumeBranch, config: TrainConfig, warming: bool, mirrored: WhatIsMirrored | None = None
) -> Callable[..., Step]:
    """Return a function that computes a step of the 3D branch on the photographs (Algorithm 1).

    `warming` raises the SH degree; `mirrored` adds what the surface mirrors, as the 2D branch stands.
    """

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        planned = config.warmup.volume_iterations
        degree = _degree(iteration, planned, branch.model.sh_degree, config, warming)
        refl_degree = _degree(iteration, planned, branch.model.refl_sh_degree, config, warming)
        needs_depth = config.tv and config.volumes.depth_tv_weight > 0
        shown: Tensor | None = None
        held: Terms = {}
        if mirrored is not None and mirrored.light.used:
            shining = mirrored.light.model.light()
            shown, held = mirrored.shown(view, shining), light_terms(shining.texels, branch.model, config)
        behind = color_tensor(background, branch.device)
        outputs = _see_volumes(branch, view, behind, degree, refl_degree, needs_depth, shown)
        terms = volume_terms(outputs, view.target(behind), config) | held
        return Step(total(terms), [Seen(branch, outputs.stats, 1.0)])

    return compute


def both_teach(
    surfels: SurfelBranch, volumes: VolumeBranch, config: TrainConfig, light: LightInTraining | None = None
) -> Callable[..., Step]:
    """Return a function that computes a step of both branches, on the photographs and on each other (Algorithm 2).

    light: the environment maps that the surface mirrors, which are trained too where they are used.
    """
    both = config.mutual.teaching is Teaching.BOTH_WAYS

    def compute(view: TrainingView, background: Color, iteration: int) -> Step:
        behind = color_tensor(background, surfels.device)
        flat = _see_surfels(surfels, view, behind, surfels.model.sh_degree, config)
        shown: Tensor | None = None
        held: Terms = {}
        if light is not None and light.used:
            normal, shining = flat.normal if both else flat.normal.detach(), light.model.light()
            shown = mirrored_light(light.model, view.camera, normal, view.covered, shining)
            held = light_terms(shining.texels, volumes.model, config)
        degrees = volumes.model.sh_degree, volumes.model.refl_sh_degree
        full = _see_volumes(volumes, view, behind, *degrees, True, shown)
        terms = mutual_terms(flat, full, view.target(behind), config) | held
        seen = [
            Seen(surfels, flat.stats, config.mutual.surfel_weight),
            Seen(volumes, full.stats, config.mutual.volume_weight),
        ]
        return Step(total(terms), [item for item in seen if item.weight > 0])

    return compute


def _degree(iteration: int, planned: int, highest: int, config: TrainConfig, warming: bool) -> int:
    return sh_degree_at(iteration, planned, config.sh_step, highest) if warming else highest


def _see_surfels(
    branch: SurfelBranch, view: TrainingView, behind: Tensor, degree: int, config: TrainConfig
) -> SurfelOutputs:
    distortion = config.surfels.distortion_weight > 0
    return render_surfels(branch.model, view.camera, behind, degree, distortion, view.light())


def _see_volumes(
    branch: VolumeBranch,
    view: TrainingView,
    behind: Tensor,
    degree: int,
    refl_degree: int,
    depth: bool,
    mirrored: Tensor | None,
) -> VolumeOutputs:
    light = (mirrored, view.light())
    return render_volumes(branch.model, view.camera, behind, degree, refl_degree, depth, *light)
