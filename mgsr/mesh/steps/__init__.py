"""The steps that finish a raw mesh, in their order.

A new step is one file in this folder and one line here. Its options, if it has any, are a file of the same name in
`mgsr/config/expert/mesh_steps/`.
"""

from mgsr.config import ExpertConfig
from mgsr.mesh.steps.bilateral_filter import BilateralFilter
from mgsr.mesh.steps.close_holes import CloseHoles
from mgsr.mesh.steps.cut_at_ground import CutAtGround
from mgsr.mesh.steps.decimate import Decimate
from mgsr.mesh.steps.drop_degenerate import DropDegenerate
from mgsr.mesh.steps.drop_small_pieces import DropSmallPieces
from mgsr.mesh.steps.fit_contours import FitContours
from mgsr.mesh.steps.keep_seen import KeepSeen
from mgsr.mesh.steps.photometric_refinement import PhotometricRefinement
from mgsr.mesh.steps.pull_into_hull import PullIntoHull
from mgsr.mesh.steps.remove_contradicted import RemoveContradicted
from mgsr.mesh.steps.shape_from_shading import ShapeFromShading
from mgsr.mesh.steps.smooth_low_frequency import SmoothLowFrequency
from mgsr.mesh.steps.step import MeshStep


def mesh_steps(expert: ExpertConfig = ExpertConfig()) -> tuple[MeshStep, ...]:
    """Return the steps with their options.

    Shading and photometric refinement take two turns: each makes deeper concavities readable for the other.
    """
    own, geometry, shading = expert.mesh.steps, expert.geometry, expert.shading
    return (
        PullIntoHull(own.pull_into_hull),
        DropDegenerate(),
        DropSmallPieces(),
        KeepSeen(),
        FitContours(geometry.contours),
        ShapeFromShading(own.shape_from_shading, 1, shading.shape, shading.light),
        PhotometricRefinement(1, shading.photometric),
        ShapeFromShading(own.shape_from_shading_2, 2, shading.shape, shading.light),
        PhotometricRefinement(2, shading.photometric),
        RemoveContradicted(own.remove_contradicted, shading.residual),
        SmoothLowFrequency(geometry.low_frequency),
        BilateralFilter(geometry.bilateral),
        CutAtGround(own.cut_at_ground),
        CloseHoles(),
        Decimate(),
    )
