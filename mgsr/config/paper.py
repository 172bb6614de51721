"""Settings that only reproduce the paper's rows, and those rows as overrides."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class StopRule(StrEnum):
    """When a warm-up ends before its iterations are spent.

    epoch: the mean loss over whole epochs hardly falls any more. validation: the PSNR of held-out training views
    stops rising. paper: the last 100 losses lie within a range, although they come from different views. none:
    never.
    """

    EPOCH = "epoch"
    VALIDATION = "validation"
    PAPER = "paper"
    NONE = "none"


class Teaching(StrEnum):
    """Which branches the two mutual losses change.

    both_ways: both. one_way: only the one that is being taught (Model K).
    """

    BOTH_WAYS = "both_ways"
    ONE_WAY = "one_way"


class DepthUnit(StrEnum):
    """What divides both depths in the mutual depth loss.

    distance: the camera's distance from the scene's centre, which is constant. maximum: the largest 3D depth, as in
    the paper; one floater changes it.
    """

    DISTANCE = "distance"
    MAXIMUM = "maximum"


class SurfaceDepth(StrEnum):
    """Which depth of the 2D branch is the surface.

    expected: the mean of the blended splats. median: the depth at which half of the light is absorbed.
    """

    EXPECTED = "expected"
    MEDIAN = "median"


class AlphaLoss(StrEnum):
    """How the rendered alpha is compared with the mask. l1: mean absolute difference. bce: binary cross-entropy."""

    L1 = "l1"
    BCE = "bce"


@dataclass(frozen=True)
class PaperConfig:
    """Settings that reproduce rows of the paper's tables and choices of other programs.

    The defaults are best for captures.
    """

    tv: bool = True  # Total variation counts. off: all its weights are zero (Model N).
    iterations_factor: float = 1.0  # The factor of mutual.iterations (Models G to J).
    teaching: Teaching = Teaching.BOTH_WAYS
    depth_unit: DepthUnit = DepthUnit.DISTANCE
    surface_depth: SurfaceDepth = SurfaceDepth.MEDIAN
    alpha_loss: AlphaLoss = AlphaLoss.L1
    distortion_weight: float = 0.0  # The weight of 2DGS's depth distortion in the 2D branch. The method has none.
    # The weight of the total variation of the 3D branch's depth. The published program has 0.05.
    gaussian_depth_tv_weight: float = 0.0
    regularise_from: float = 0.0  # The fraction of the warm-up after which lambda_3 to lambda_5 apply.
    stop_rule: StopRule = StopRule.EPOCH
    validation_views: int = 3  # The number of training views held out of the warm-up, with stop_rule=validation.
    validation_every: int = 100  # Iterations between two validations.
    validation_patience: int = 4  # The warm-up ends after this many validations without a gain.
    validation_gain: float = 0.05  # The rise of the PSNR that counts as a gain, in dB.
    # A branch has converged if the last 100 losses lie within this range, with stop_rule=paper.
    loss_range: float = 0.01


# The supplement's rows. E, I and M are the method itself; the published weights of C, D and F are not known.
ABLATIONS: dict[str, dict[str, str]] = {
    "A": {"branches": "gaussians", "reflection": "own", "flash": "off"},
    "B": {"branches": "surfels", "flash": "off"},
    "C": {"surfel_weight": "0.25", "gaussian_weight": "0.75"},
    "D": {"surfel_weight": "0.75", "gaussian_weight": "0.25"},
    "E": {},
    "F": {"mutual.depth_weight": "0.1"},
    "G": {"iterations_factor": "0.25"},
    "H": {"iterations_factor": "0.5"},
    "I": {},
    "J": {"iterations_factor": "1.5"},
    "K": {"teaching": "one_way"},
    "L": {"stop_rule": "none"},
    "M": {},
    "N": {"tv": "off"},
}
