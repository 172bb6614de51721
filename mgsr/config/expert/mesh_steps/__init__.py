"""Options of the steps that finish a mesh (`mgsr.mesh.steps`), in one file for each step, named as the step's file.

Options of an algorithm that a step calls stand with the algorithm's package instead. Pixels are those of the
photographs on the surface; a footprint is what a pixel of the rendered views covers there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert.mesh_steps.cut_at_ground import CutAtGroundOptions
from mgsr.config.expert.mesh_steps.pull_into_hull import PullIntoHullOptions
from mgsr.config.expert.mesh_steps.remove_contradicted import RemoveContradictedOptions
from mgsr.config.expert.mesh_steps.shape_from_shading import FIRST_TURN, SECOND_TURN
from mgsr.config.expert.shading import ShadingPass
from mgsr.config.options import Options


@dataclass(frozen=True)
class MeshStepOptions(Options):
    """The steps that finish a mesh."""

    pull_into_hull: PullIntoHullOptions = field(default_factory=PullIntoHullOptions)
    shape_from_shading: ShadingPass = FIRST_TURN
    shape_from_shading_2: ShadingPass = SECOND_TURN
    remove_contradicted: RemoveContradictedOptions = field(default_factory=RemoveContradictedOptions)
    cut_at_ground: CutAtGroundOptions = field(default_factory=CutAtGroundOptions)
