"""What a step of the mesh's finishing is, what it is given, and what it reports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from mgsr.config import MeshConfig
from mgsr.errors import MeshError
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.consistency import SilhouetteHull
from mgsr.mesh.views import SurfaceView
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photo_set import PhotoSet

SHOWN = 0.6  # share of an image's side that the object takes up

Outcome = Mapping[str, float | bool | str]


class SceneFacts(Protocol):
    """What the cost of a step depends on (`mgsr.budget.costs.Facts`)."""

    @property
    def views(self) -> int: ...
    @property
    def pixels(self) -> float: ...
    @property
    def size(self) -> float: ...
    @property
    def shiny(self) -> bool: ...
    @property
    def masked(self) -> bool: ...
    @property
    def learned(self) -> bool: ...
    @property
    def flash(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class StepContext:
    """What all steps of one extraction share.

    views: the rendered surface; photos: the training photographs with their silhouettes, both maybe none; footprint:
    the median size of a rendered pixel on the surface, in the scene's unit; hull: the visual hull, None where it holds
    nothing; go_on: whether there is time for another round of refinement.
    """

    views: Sequence[SurfaceView]
    photos: PhotoSet
    config: MeshConfig
    footprint: float
    hull: SilhouetteHull | None
    go_on: Callable[[], bool]

    def require_faces(self, mesh: Mesh, reason: str) -> None:
        """Raise MeshError with the reason, and what to do about it, for a mesh without faces."""
        if len(mesh.faces) == 0:
            raise MeshError(f"empty mesh: {reason}; {cure(self.config)}")


@dataclass(frozen=True)
class StepResult:
    """The mesh and the light estimate after a step; outcome: what the report tells of it."""

    mesh: Mesh
    light: LightEstimate
    outcome: Outcome = field(default_factory=dict)


@dataclass(frozen=True)
class StepReport:
    """What the report says of a step: the seconds that it took, the faces that it left, and its outcome."""

    seconds: float
    faces: int
    outcome: Outcome


class MeshStep(ABC):
    """A step of the mesh's finishing.

    Its options are fields of a frozen dataclass with unit and meaning. name: its key in the report.
    """

    refines = False  # whether it is refinement by the photographs, which a time budget may leave out

    @property
    @abstractmethod
    def name(self) -> str: ...

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        """Return whether the step is taken."""
        return True

    def cost(self, facts: SceneFacts, config: MeshConfig) -> float:
        """Return the seconds that the step takes, as `mgsr.budget.costs` counts them; 0 where they do not matter."""
        return 0.0

    @abstractmethod
    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        """Take the step. Raises MeshError where no surface is left."""


class TimeLeft:
    """Whether there is time: once `go_on` says no, it stays no."""

    def __init__(self, go_on: Callable[[], bool]) -> None:
        self._go_on, self._left = go_on, True

    def __call__(self) -> bool:
        self._left = self._left and self._go_on()
        return self._left


def cure(config: MeshConfig) -> str:
    """Return what to do where no surface comes out."""
    return (
        "look at the rendered depth of the 2D branch: train it longer, or relax "
        f"mesh.min_alpha={config.min_alpha}, mesh.min_cos={config.min_cos}, mesh.consistency={config.consistency} or "
        f"mesh.radius={config.radius}"
    )


def rendered_pixels(facts: SceneFacts, config: MeshConfig) -> float:
    """Return the pixels of all rendered views together."""
    return min(facts.views * facts.pixels * config.view_scale**2, config.max_pixels)


def surface_cells(facts: SceneFacts, config: MeshConfig) -> float:
    """Return the number of faces along a side of the extracted surface, as a share of 256."""
    across = SHOWN * (rendered_pixels(facts, config) / facts.views) ** 0.5
    return float(min(2**config.poisson_depth, across) / 256)


def reading_size(facts: SceneFacts, config: MeshConfig) -> float:
    """Return what reading the photographs at every vertex takes, as a share of the usual.

    There is one vertex for each cell of the surface, but none finer than pixels.
    """
    cells = min(1.0, 2**config.poisson_depth / facts.pixels**0.5)
    return float((facts.views / 48 * facts.size) ** 0.7 * cells**1.2)
