"""How the two branches are trained."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TypeVar

from mgsr.config.paper import PaperConfig


class Branches(StrEnum):
    """Which branches are trained. A single branch continues with its own loss in the mutual phase."""

    BOTH = "both"
    SURFELS = "surfels"
    GAUSSIANS = "gaussians"


class Background(StrEnum):
    """What lies behind the splats in training.

    auto: random colours if there are masks; otherwise the colour of a plain backdrop, with learned silhouettes;
    otherwise the photographs' mean colour, which is the least wrong where no splats are.
    """

    AUTO = "auto"
    RANDOM = "random"
    WHITE = "white"
    BLACK = "black"


@dataclass(frozen=True)
class RatesConfig:
    """Learning rates of Adam.

    The rate of positions decays exponentially over the whole run. The other rates stay constant at first, while
    colours and shapes settle roughly, and then decay. The published rates are for 30,000 iterations; these are for
    some thousands.
    """

    position: float = 4e-4  # The initial rate of positions, times the scene's extent. The published rate is 1.6e-4.
    position_end: float = 4e-6  # The final rate of positions, times the scene's extent. The published rate is 1.6e-6.
    sh: float = 1e-2  # The rate of the constant term of colour. The published rate is 2.5e-3.
    sh_rest: float = 4e-3  # The rate of the direction-dependent terms of colour. The published rate is 1.25e-4.
    opacity: float = 5e-2  # The rate of the opacities' logits.
    weight: float = 5e-2  # The rate of the reflection weights' logits.
    scale: float = 1e-2  # The rate of the log-scales. The published rate is 5e-3.
    rotation: float = 4e-3  # The rate of the quaternions. The published rate is 1e-3.
    decay_from: float = 0.5  # The fraction of the run after which the other rates decay.
    final_factor: float = 0.1  # The factor that the other rates reach at the end. The published factor is 1.
    beta1: float = 0.9  # Adam's decay of the mean gradient.
    beta2: float = 0.999  # Adam's decay of the mean squared gradient.
    eps: float = 1e-15  # Adam's term against division by zero.


class Growth(StrEnum):
    """Where Gaussians are added.

    gradient: Gaussians with a large screen-space gradient are cloned or split. error: new ones appear where renders
    differ visibly from photographs. Scenes without masks always use the gradient, because the depth of their
    background is too uncertain.
    """

    GRADIENT = "gradient"
    ERROR = "error"


@dataclass(frozen=True)
class DensifyConfig:
    """Clone, split and prune splats by the screen-space gradient (3DGS, section 5)."""

    # Splats whose mean gradient of the loss exceeds this are cloned or split. The gradient is per half image side, so
    # that it does not depend on the image size.
    gradient_threshold: float = 2e-4
    every: int = 100  # Iterations between two rounds.
    start: float = 0.05  # The fraction of the warm-up after which densification begins.
    stop: float = 0.75  # The fraction of the warm-up after which densification ends.
    # The fraction of the mutual phase after which densification ends there. 0: none in the mutual phase.
    mutual_stop: float = 0.0
    reset_every: int | None = None  # Iterations between opacity resets, a multiple of `every`. none: never.
    reset_opacity: float = 0.01  # A reset lowers opacities to this.
    prune_opacity: float = 0.05  # Splats of lower opacity than this are pruned.
    split_above: float = 0.01  # Splats longer than this times the extent are split. Shorter ones are cloned.
    split_shrink: float = 1.6  # A split divides the scales by this.
    prune_above: float = 0.1  # Splats longer than this times the extent are pruned.
    max_count: int = 1_000_000  # No splats are added beyond this number.
    # The gradient adds no splats beyond this many times the starting points, or max_start if that is more. none: it
    # has no such limit.
    max_growth: float | None = 1.25
    # After the warm-up, the splats that contribute least are pruned: together this share of all contributions. Scenes
    # without masks prune none, because a few huge background splats contribute most there.
    prune_contribution: float = 0.06


Densify = TypeVar("Densify", bound=DensifyConfig)


@dataclass(frozen=True)
class GaussianDensifyConfig(DensifyConfig):
    """How the 3D branch gains and loses Gaussians: as in DensifyConfig, or by the errors of its renders."""

    by: Growth = Growth.ERROR
    # A difference of colour is visible if its mean over 3 x 3 pixels exceeds this (sRGB 0..1).
    tolerance: float = 0.04
    growth: float = 0.5  # The largest share of the count that one round adds.
    # The largest share of the count that one round replaces. The Gaussians that contribute least go.
    replace: float = 0.1
    growth_views: int = 8  # The number of training views that one round renders.
    new_opacity: float = 0.6  # The opacity of Gaussians that errors add.
    scale_rate: float = 2e-2  # The learning rate of log-scales with by=error, in place of rates.scale.
    beta2: float = 0.99  # Adam's beta2 with by=error, in place of rates.beta2.
    prune_opacity: float = 0.005  # Gaussians of lower opacity than this are pruned.
    max_growth: float | None = 1.5
    # After the warm-up, the Gaussians that contribute least are pruned: together this share of all contributions.
    # Scenes without masks prune none.
    prune_contribution: float = 0.01


@dataclass(frozen=True)
class SurfelConfig:
    """The 2D branch: the surface."""

    sh_degree: int = 2  # The SH degree of colour. With a higher one, colour explains what the shape should.
    # More starting points than this are thinned at random. Masked objects get more of them where the photographs show
    # their surface with many pixels (expert.start.usual_pixels).
    max_start: int = 16_000
    unmasked_start: int = 40_000  # max_start for scenes without masks, where points lie on the background too.
    start_opacity: float = 0.9  # The initial opacity.
    # The initial scale, times the mean distance of the three nearest neighbours. Wide disks stand off curved surfaces.
    start_scale: float = 0.4
    # The weight lambda_3 of the difference between rendered normals and the normals of the depth. It multiplies
    # normal_tv_weight too.
    normal_weight: float = 0.05
    normal_tv_weight: float = 1.0  # The weight lambda_4 of the total variation of normals.
    # The weight lambda_5 of the total variation of depth. The paper's 1 flattens and shrinks surfaces.
    depth_tv_weight: float = 0.1
    alpha_weight: float = 0.1  # The weight of the difference between alpha and mask, in scenes with masks.
    # The loss of this branch leaves out this many pixels on either side of the mask's contour. There, soft edges of
    # splats would make the object smaller.
    edge_band: int = 4
    # Positions move slowly: from near the surface, faster ones drift behind it (by half a pixel on shiny scenes).
    rates: RatesConfig = field(
        default_factory=lambda: RatesConfig(position=5e-5, position_end=5e-6, sh_rest=2e-3, scale=5e-3)
    )
    densify: DensifyConfig = field(default_factory=DensifyConfig)


class Reflection(StrEnum):
    """What the 3D branch adds to the transmitted light.

    auto: model selection decides. off: nothing, as in 3DGS. own: each splat's reflected colour times its weight, as
    in the paper. shared: two environment maps, which the surface of the 2D branch reflects. both: the maps and each
    splat's own reflection.
    """

    AUTO = "auto"
    OFF = "off"
    OWN = "own"
    SHARED = "shared"
    BOTH = "both"


@dataclass(frozen=True)
class GaussianConfig:
    """The 3D branch: rendering and the light split."""

    reflection: Reflection = Reflection.AUTO
    # The SH degree of the transmitted colour. A low degree cannot hold highlights. A flash needs 2.
    sh_degree: int = 2
    reflected_sh_degree: int = 3  # The SH degree of the reflected colour.
    max_start: int = 10_000  # More starting points than this are thinned at random.
    unmasked_start: int = 100_000  # max_start for scenes without masks, where points lie on the background too.
    start_opacity: float = 0.5  # The initial opacity.
    start_scale: float = 1.0  # The initial scale, times the mean distance of the three nearest neighbours.
    start_weight: float = 0.4  # The initial reflection weight beta, inside (0, 1).
    start_reflected: float = 0.05  # The initial grey of the reflected colour, 0..1.
    # Each footprint is widened by this many px^2. 3DGS has 0.3, which blurs contours and fits one image size.
    low_pass: float = 0.05
    # The weight lambda_2 of the total variation of the transmitted image. The paper has 1, the published program 0.1.
    transmitted_tv_weight: float = 0.05
    reflected_cost: float = 0.15  # The weight of the mean of W * C_ref. The transmitted light must explain what it can.
    alpha_weight: float = 0.1  # The weight of the difference between alpha and mask, in scenes with masks.
    rates: RatesConfig = field(default_factory=RatesConfig)
    densify: GaussianDensifyConfig = field(default_factory=GaussianDensifyConfig)


@dataclass(frozen=True)
class EnvironmentMapConfig:
    """The environment maps that the surface reflects (see Reflection)."""

    side: int = 64  # The side of a map, in texels.
    start: float = 0.007  # The initial light of the maps, 0..1.
    rate: float = 0.03  # The learning rate of the light's logits.
    decay_from: float = 0.5  # The fraction of the run after which the rate decays.
    final_factor: float = 0.1  # The factor that the rate reaches at the end.
    smoothness: float = 0.05  # The weight of the mean squared difference between neighbouring texels.
    # Iterations of the 3D branch and the maps after mesh extraction. The mesh then reflects in place of the 2D branch.
    # They need masks. 0: none.
    iterations: int = 300
    finish_rates: float = 2.0  # The learning rates in those iterations, times those of the middle of training.
    weight_prior: float = 5e-7  # The weight that pulls each reflection weight to its initial value.


@dataclass(frozen=True)
class ModelSelectionConfig:
    """How the kind of reflection is chosen.

    The 3D branch warms up without reflection. Two candidates continue from there: off, and shared (or own, where no
    surface reflects). off stays unless the other renders held-out photographs better. Lower SH degrees of the
    transmitted colour stay if they are no worse.

    Without iterations, or with too few photographs, the start decides by how brightness changes between views:
    shared if it changes as reflected light does, off if it does not, both if that is unknown.
    """

    start: float = 0.5  # The fraction of the 3D branch's warm-up before the selection.
    iterations: int = 150  # Iterations of each candidate. 0: no selection.
    views: int = 6  # The number of training photographs held out until the selection ends, at most a quarter of all.
    gain: float = 0.1  # The dB by which a less simple candidate must be better.


@dataclass(frozen=True)
class WarmupConfig:
    """The training of each branch alone (supplement, Algorithm 1)."""

    surfel_iterations: int = 800  # The most iterations of the 2D branch.
    gaussian_iterations: int = 2000  # The most iterations of the 3D branch.
    # The fraction of the iterations on photographs of half the size. It ends before model selection.
    coarse: float = 0.4
    coarse_side: int = 400  # Photographs are not halved if the shorter side of one has fewer pixels than this.
    stop_after: float = 0.75  # The fraction of the iterations before which no branch stops.
    epoch_span: int = 5  # The number of epochs that are averaged and compared with as many before them.
    epoch_gain: float = 0.002  # A branch has converged if its mean loss falls by less than this share.


@dataclass(frozen=True)
class MutualConfig:
    """The phase in which both branches teach each other (supplement, Algorithm 2)."""

    iterations: int = 1600  # Iterations of the mutual phase.
    surfel_weight: float = 0.5  # The weight of L_2D in the total loss.
    gaussian_weight: float = 0.5  # The weight of L_3D in the total loss.
    depth_weight: float = 0.01  # The weight of L_depth in the total loss.
    photo_weight: float = 0.3  # The photograph's share lambda_6 in the 2D branch's target. C_tran has the rest.


@dataclass(frozen=True)
class WatchConfig:
    """How often training reports, checks and saves. None of it changes the result."""

    report_every: int = 50  # Iterations between progress reports.
    curve_every: int = 250  # Iterations between points of the training curve.
    curve_views: int = 2  # The number of test views that the curve measures. They decide nothing.
    preview_every: int | None = None  # Iterations between previews. none: never.
    check_every: int = 25  # Iterations between checks of the parameters and the loss. Bad steps are undone.
    checkpoint_every: int = 1000  # Iterations between checkpoints.
    checkpoint_seconds: float | None = None  # The most seconds between two checkpoints. none: no limit.


@dataclass(frozen=True)
class TrainConfig:
    """How the two branches are trained."""

    branches: Branches = Branches.BOTH
    l1_weight: float = 0.8  # The weight lambda_1 of L1. 1 - SSIM has the rest.
    # If the start finds a flash, splats hold colours under even light, and MGSR shades them. off: they hold the
    # colours of the photographs.
    flash: bool = True
    background: Background = Background.AUTO
    # Only the mask's box and this many pixels around it are rendered. none: the whole photograph.
    crop_margin: int | None = 16
    # No splat may be nearer to a training camera than this share of the way to the nearest starting points, in scenes
    # without masks. 0: off.
    clearance: float = 0.5
    sh_step: float = 0.02  # The fraction of the warm-up between two increases of the SH degree.
    warmup: WarmupConfig = field(default_factory=WarmupConfig)
    mutual: MutualConfig = field(default_factory=MutualConfig)
    surfels: SurfelConfig = field(default_factory=SurfelConfig)
    gaussians: GaussianConfig = field(default_factory=GaussianConfig)
    environment_map: EnvironmentMapConfig = field(default_factory=EnvironmentMapConfig)
    model_selection: ModelSelectionConfig = field(default_factory=ModelSelectionConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    watch: WatchConfig = field(default_factory=WatchConfig)


def starting_settings(
    train: TrainConfig, masked: bool, points: int, detail: float = 1.0
) -> tuple[SurfelConfig, GaussianConfig]:
    """Return both branches' settings as they hold for a scene with or without masks (see Growth).

    points: the number of starting points. detail: the factor on a masked scene's surfels (`StartConfig.detail`).
    max_start and max_count of the result are those of the scene.
    """
    surfels, gaussians = train.surfels, train.gaussians
    most = round(detail * surfels.max_start) if masked else surfels.unmasked_start
    flat = _limited(surfels.densify, max(min(points, most), surfels.max_start))
    surfels = replace(surfels, max_start=most, densify=flat)
    if gaussians.densify.by is Growth.ERROR and masked:
        rates = replace(gaussians.rates, scale=gaussians.densify.scale_rate, beta2=gaussians.densify.beta2)
        return surfels, replace(gaussians, rates=rates)
    most = gaussians.max_start if masked else gaussians.unmasked_start
    full = replace(_limited(gaussians.densify, max(min(points, most), gaussians.max_start)), by=Growth.GRADIENT)
    return surfels, replace(gaussians, max_start=most, densify=full)


def _limited(densify: Densify, start: int) -> Densify:
    """Return the settings with max_count as the limit of growth by gradients from `start` splats."""
    if densify.max_growth is None:
        return densify
    return replace(densify, max_count=min(densify.max_count, round(densify.max_growth * start)))
