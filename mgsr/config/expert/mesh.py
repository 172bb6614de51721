"""Options of the mesh's extraction and of the steps that finish it (`mgsr.mesh`).

Pixels are those of the photographs on the surface; a footprint is what a pixel of the rendered views covers there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert.shading import ShadingPass
from mgsr.config.options import NotNegative, Options, Share, WholeNumber


@dataclass(frozen=True)
class PullIntoHullOptions(Options):
    """The pull of vertices into the silhouettes."""

    rounds: WholeNumber = 3  # of moving vertices along their normals


@dataclass(frozen=True)
class RemoveContradictedOptions(Options):
    """The removal of patches with a large photometric residual under a flash."""

    share: Share = 0.5  # of the largest residual, above which a face belongs to a patch
    min_pixels: NotNegative = 10.0  # that a patch covers at least


@dataclass(frozen=True)
class CutAtGroundOptions(Options):
    """The cut at the plane on which a found object stands."""

    sunk: NotNegative = 1.0  # footprints below the plane that are kept


@dataclass(frozen=True)
class MeshStepOptions(Options):
    """The steps that finish a mesh."""

    pull_into_hull: PullIntoHullOptions = field(default_factory=PullIntoHullOptions)
    shape_from_shading: ShadingPass = field(default_factory=lambda: ShadingPass(edge=1.0, rounds=3, reach=60.0))
    shape_from_shading_2: ShadingPass = field(default_factory=lambda: ShadingPass(edge=1.0, rounds=2, reach=60.0))
    remove_contradicted: RemoveContradictedOptions = field(default_factory=RemoveContradictedOptions)
    cut_at_ground: CutAtGroundOptions = field(default_factory=CutAtGroundOptions)


@dataclass(frozen=True)
class MeshOptions(Options):
    """The mesh's extraction and finishing."""

    steps: MeshStepOptions = field(default_factory=MeshStepOptions)
