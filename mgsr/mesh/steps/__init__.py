"""The steps that finish a raw mesh, in their order. A new step is one file in this folder and one line here."""

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

# Shading and photometric refinement take two turns: each makes deeper concavities readable for the other.
STEPS: tuple[MeshStep, ...] = (
    PullIntoHull(),
    DropDegenerate(),
    DropSmallPieces(),
    KeepSeen(),
    FitContours(),
    ShapeFromShading(turn=1, rounds=3),
    PhotometricRefinement(turn=1),
    ShapeFromShading(turn=2, rounds=2),
    PhotometricRefinement(turn=2),
    RemoveContradicted(),
    SmoothLowFrequency(),
    BilateralFilter(),
    CutAtGround(),
    CloseHoles(),
    Decimate(),
)
