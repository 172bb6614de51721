"""The interface of the steps that finish a mesh: their context, results and reports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mgsr.config import MeshConfig
from mgsr.config.expert import MeshOptions
from mgsr.data.cost_factors import CostFactors
from mgsr.errors import MeshError
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.consistency import SilhouetteHull
from mgsr.mesh.views import SurfaceView
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photo_set import PhotoSet

SHOWN = 0.6  # the assumed extent of the object in a photograph, as a share of the image's side
USUAL_CELLS = 256  # cells along a side of the reference scene's surface
VERTEX_GROWTH = 1.2  # exponent by which the cost of sampling the photographs grows with the cells along a side

Outcome = Mapping[str, float | bool | str]


@dataclass(frozen=True, eq=False)
class StepContext:
    """The input that all steps of one extraction share.

    views: the rendered surface.
    photos: the training photographs with their silhouettes, both possibly empty.
    footprint: the median size of a rendered pixel on the surface, in the scene's unit.
    hull: the visual hull that bounds the mesh, None without one.
    go_on: returns whether there is time for another round of refinement.
    ground [4]: the plane on which a found object stands, None if it is unknown (see `Scene.ground`).
    options: the options of the extraction.
    """

    views: Sequence[SurfaceView]
    photos: PhotoSet
    config: MeshConfig
    footprint: float
    hull: SilhouetteHull | None
    go_on: Callable[[], bool]
    ground: np.ndarray | None = None
    options: MeshOptions = MeshOptions()

    def require_faces(self, mesh: Mesh, reason: str) -> None:
        """Raise MeshError with the reason and a remedy if the mesh has no faces."""
        if len(mesh.faces) == 0:
            raise MeshError(f"empty mesh: {reason}; {cure(self.config)}")


@dataclass(frozen=True)
class StepResult:
    """The mesh and the light estimate after a step; outcome: the step's entries in the report."""

    mesh: Mesh
    light: LightEstimate
    outcome: Outcome = field(default_factory=dict)


@dataclass(frozen=True)
class StepReport:
    """The report on a step: its duration in seconds, the number of faces after it, and its outcome."""

    seconds: float
    faces: int
    outcome: Outcome


class MeshStep(ABC):
    """A step that finishes a mesh.

    A step is a frozen dataclass; its fields are its options. name: its key in the report.
    """

    refines = False  # True for refinement by the photographs, which a time budget may skip

    @property
    @abstractmethod
    def name(self) -> str: ...

    def applies(self, context: StepContext, light: LightEstimate) -> bool:
        """Return whether the step applies."""
        return True

    def cost(self, factors: CostFactors, config: MeshConfig) -> float:
        """Return the step's duration in seconds, as `mgsr.budget.costs` counts them; 0 if negligible."""
        return 0.0

    @abstractmethod
    def run(self, mesh: Mesh, light: LightEstimate, context: StepContext) -> StepResult:
        """Run the step. Raises MeshError if no surface is left."""


class TimeLeft:
    """A callable that returns whether time is left: False for good once `go_on` returns False."""

    def __init__(self, go_on: Callable[[], bool]) -> None:
        self._go_on, self._left = go_on, True

    def __call__(self) -> bool:
        self._left = self._left and self._go_on()
        return self._left


def cure(config: MeshConfig) -> str:
    """Return a remedy for an extraction without surface."""
    return (
        f"check the rendered depth of the 2D branch; train it longer, or relax mesh.min_alpha={config.min_alpha}, "
        f"mesh.min_cos={config.min_cos}, mesh.consistency={config.consistency} or mesh.radius={config.radius}"
    )


def rendered_pixels(factors: CostFactors, config: MeshConfig) -> float:
    """Return the total number of pixels of all rendered views."""
    return min(factors.views * factors.pixels * config.view_scale**2, config.max_pixels)


def surface_cells(factors: CostFactors, config: MeshConfig) -> float:
    """Return the number of cells along a side of the extracted surface, relative to USUAL_CELLS."""
    across = SHOWN * (rendered_pixels(factors, config) / factors.views) ** 0.5
    return float(min(2**config.poisson_depth, across) / USUAL_CELLS)


def reading_size(factors: CostFactors, config: MeshConfig) -> float:
    """Return the cost of sampling the photographs at every vertex, relative to the reference scene.

    There is one vertex for each cell of the surface, but no more than pixels allow.
    """
    cells = min(1.0, 2**config.poisson_depth / factors.pixels**0.5)
    return float(factors.surface_work * cells**VERTEX_GROWTH)
