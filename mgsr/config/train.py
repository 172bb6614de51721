"""How the two branches are trained."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

from mgsr.config.paper import PaperConfig


class Branches(StrEnum):
    """Which branches are trained. With one alone the mutual phase goes on with that branch's own loss."""

    BOTH = "both"
    SURFELS = "surfels"
    GAUSSIANS = "gaussians"


class Background(StrEnum):
    """What lies behind the splats in training. auto: random where there are masks, else the colour of a plain backdrop
    where photographs have one (outlines are then learned), and white."""

    AUTO = "auto"
    RANDOM = "random"
    WHITE = "white"
    BLACK = "black"


@dataclass(frozen=True)
class RatesConfig:
    """Learning rates, a step of Adam each. The position's decays exponentially over the whole run; the others stay for
    a while, in which colours and shapes find their place, and decay then, which settles them.

    The published rates are for 30,000 iterations; these are for some thousands."""

    position: float = 4e-4  # times the scene's extent, at the start; published 1.6e-4
    position_end: float = 4e-6  # times the scene's extent, at the end; published 1.6e-6
    sh: float = 1e-2  # the constant term of colour; published 2.5e-3
    sh_rest: float = 4e-3  # the direction-dependent terms; published 1.25e-4
    opacity: float = 5e-2
    weight: float = 5e-2  # the reflection weight's logit
    scale: float = 1e-2  # log-scale; published 5e-3
    rotation: float = 4e-3  # published 1e-3
    decay_from: float = 0.5  # fraction of the run after which the other rates begin to decay
    final_factor: float = 0.1  # factor that they have reached at the end; published 1
    beta1: float = 0.9
    beta2: float = 0.999
    eps: float = 1e-15


class Growth(StrEnum):
    """What tells where Gaussians are added. gradient: those with a large screen-space gradient are cloned or split.
    error: new ones where renderings differ visibly from the photographs, in scenes with masks; without masks the depth
    of the background is too uncertain for that, and the gradient tells."""

    GRADIENT = "gradient"
    ERROR = "error"


@dataclass(frozen=True)
class DensifyConfig:
    """Clone, split and prune on the screen-space gradient (3DGS, section 5)."""

    gradient_threshold: float = 2e-4  # mean gradient of the loss per half image side (so independent of image size)
    every: int = 100  # iterations
    start: float = 0.05  # fraction of the warm-up
    stop: float = 0.75  # fraction of the warm-up
    mutual_stop: float = 0.0  # fraction of the mutual phase; 0 is never in it
    reset_every: int | None = None  # iterations between opacity resets (a multiple of `every`); none is never
    reset_opacity: float = 0.01  # a reset lowers opacities to this
    prune_opacity: float = 0.05  # splats under this go
    split_above: float = 0.01  # splats longer than this times the extent are split, shorter ones cloned
    split_shrink: float = 1.6  # a split divides the scales by this
    prune_above: float = 0.1  # splats longer than this times the extent go
    max_count: int = 40_000  # splats; none are added beyond them
    prune_contribution: float = 0.06  # share of all contributions; splats that together contribute less go after the
    # warm-up; masked scenes only: in others a few huge ones in the background contribute most


@dataclass(frozen=True)
class GaussianDensifyConfig(DensifyConfig):
    """How the 3D branch gains and loses Gaussians: as DensifyConfig says, or by the errors of its renderings."""

    by: Growth = Growth.ERROR
    tolerance: float = 0.04  # mean over 3 x 3 pixels of the difference, sRGB 0..1, from which it counts as visible
    growth: float = 0.5  # largest share of the count that is added in one round
    replace: float = 0.1  # largest share of the count that is replaced in one round: those that contribute least
    growth_views: int = 8  # training views that are rendered in one round
    new_opacity: float = 0.6  # of Gaussians that are added by errors
    scale_rate: float = 2e-2  # learning rate of log-scales, in place of rates.scale, where errors tell
    beta2: float = 0.99  # of Adam, in place of rates.beta2, where errors tell
    unmasked_count: int = 20_000  # max_count where the gradient tells because there are no masks
    prune_opacity: float = 0.005
    max_count: int = 1_000_000
    prune_contribution: float = 0.01


@dataclass(frozen=True)
class SurfelConfig:
    """The 2D branch: the surface."""

    sh_degree: int = 2  # more lets colour explain what the shape should
    max_start: int = 16_000  # splats; more starting points are thinned to this, by the seed
    start_opacity: float = 0.9
    start_scale: float = 0.4  # times the mean distance of the three nearest neighbours; wide disks stand off curves
    normal_weight: float = 0.05  # lambda_3: rendered normal against the depth's, times normal_tv_weight too
    normal_tv_weight: float = 1.0  # lambda_4
    depth_tv_weight: float = 0.1  # lambda_5; the paper's 1 flattens and shrinks
    alpha_weight: float = 0.1  # alpha against the mask; masked scenes only
    edge_band: int = 4  # pixels on either side of the mask's outline where this branch is not judged: there the soft
    # edges of splats would be paid for by a smaller object
    # Positions move slowly: from near the surface, faster ones drift behind it (by half a pixel on shiny scenes).
    rates: RatesConfig = field(
        default_factory=lambda: RatesConfig(position=5e-5, position_end=5e-6, sh_rest=2e-3, scale=5e-3)
    )
    densify: DensifyConfig = field(default_factory=lambda: DensifyConfig(max_count=20_000))


class Reflection(StrEnum):
    """What the 3D branch adds to the transmitted light. auto: model selection decides (see ModelSelectionConfig).

    off: nothing (3DGS). own: each splat's reflected colour, times its weight (the paper's). shared: two maps, the same
    for all splats, of the environment that the 2D branch's surface reflects. both: the maps added to the splats' own.
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
    sh_degree: int = 2  # of the transmitted colour; low, so that it can't hold highlights (a flash needs 2 in sRGB)
    reflected_sh_degree: int = 3
    max_start: int = 10_000  # splats; more starting points are thinned to this, by the seed
    start_opacity: float = 0.5
    start_scale: float = 1.0  # times the mean distance of the three nearest neighbours
    start_weight: float = 0.4  # beta; must lie inside (0, 1)
    start_reflected: float = 0.05  # grey of the reflected colour, 0..1
    low_pass: float = 0.05  # px^2 added to each footprint; 3DGS has 0.3, which blurs outlines and fits one image size
    transmitted_tv_weight: float = 0.05  # lambda_2: 1 in the paper, 0.1 in the published program
    reflected_cost: float = 0.15  # on the mean of W * C_ref: what the transmitted light can explain, it must
    alpha_weight: float = 0.1  # alpha against the mask; masked scenes only
    rates: RatesConfig = field(default_factory=RatesConfig)
    densify: GaussianDensifyConfig = field(default_factory=GaussianDensifyConfig)


@dataclass(frozen=True)
class EnvironmentMapConfig:
    """The environment maps that the surface reflects (see Reflection)."""

    side: int = 64  # texels along a map's side
    start: float = 0.007  # the maps' light, 0..1
    rate: float = 0.03  # learning rate of the light's logits
    decay_from: float = 0.5  # fraction of the run after which the rate begins to decay
    final_factor: float = 0.1  # factor that it has reached at the end
    smoothness: float = 0.05  # weight of the mean square of differences between neighbouring texels
    iterations: int = 300  # of the 3D branch and the maps after the surface was made, which then reflects instead of
    # the 2D branch; masked scenes only; 0 is never
    weight_prior: float = 5e-7  # pull of each splat's reflection weight to its start


@dataclass(frozen=True)
class ModelSelectionConfig:
    """The 3D branch warms up without any reflection. Then each of off and shared, or of off and own where no surface
    reflects, goes on from there for a while, and off stays unless the other renders photographs kept from training
    better; lower degrees of the transmitted colour's harmonics stay as long as they are no worse.

    Without iterations, or with too few photographs, the start decides: off where brightness does not change from view
    to view as reflected light does, shared where it does, both where that is not known.
    """

    start: float = 0.5  # fraction of the 3D branch's warm-up that comes before
    iterations: int = 150  # of each; 0 is no selection
    views: int = 6  # training photographs kept from the warm-up until the selection is over; at most a quarter
    gain: float = 0.1  # dB that a less simple one must render better


@dataclass(frozen=True)
class WarmupConfig:
    """Each branch alone (supplement, Algorithm 1)."""

    surfel_iterations: int = 800  # at most
    gaussian_iterations: int = 2000  # at most
    coarse: float = 0.4  # fraction of the iterations on photographs of half the size; never those of model selection
    coarse_side: int = 400  # pixels; photographs whose shorter side is smaller are not made smaller still
    stop_after: float = 0.75  # fraction of the iterations before which no branch stops
    epoch_span: int = 5  # epochs that are averaged and compared with as many before them
    epoch_gain: float = 0.002  # relative fall of the loss under which a branch has converged


@dataclass(frozen=True)
class MutualConfig:
    """Both branches teach each other (supplement, Algorithm 2)."""

    iterations: int = 1600
    surfel_weight: float = 0.5  # of L_2D in the total
    gaussian_weight: float = 0.5  # of L_3D in the total
    depth_weight: float = 0.01  # of L_depth in the total
    photo_weight: float = 0.3  # lambda_6: the photograph's share in the 2D branch's target; the rest is C_tran's


@dataclass(frozen=True)
class WatchConfig:
    """How often the loop looks up from its work; none of it changes the result."""

    report_every: int = 50  # iterations between progress reports
    curve_every: int = 250  # iterations between rows of the curve
    curve_views: int = 2  # test views that the curve is measured on; they decide nothing
    preview_every: int | None = None  # iterations between previews; none is never
    check_every: int = 25  # iterations between looks back for parameters or a loss that went bad, which are undone
    checkpoint_every: int = 1000  # iterations between checkpoints, where a path is given
    checkpoint_seconds: float | None = None  # and at most so long between two; none is any time


@dataclass(frozen=True)
class TrainConfig:
    """How the two branches are trained."""

    branches: Branches = Branches.BOTH
    l1_weight: float = 0.8  # lambda_1 on L1; the rest is on 1 - SSIM
    flash: bool = True  # where the start finds one, splats hold colours as under even light, which it then lights
    background: Background = Background.AUTO
    crop_margin: int | None = 16  # pixels around the mask's box that the photographic losses see; none is the image
    clearance: float = 0.5  # share of the way from a training camera to the nearest starting points in which no splats
    # may lie; scenes without masks only; 0 is none
    sh_step: float = 0.02  # fraction of the warm-up between two rises of the SH degree
    warmup: WarmupConfig = field(default_factory=WarmupConfig)
    mutual: MutualConfig = field(default_factory=MutualConfig)
    surfels: SurfelConfig = field(default_factory=SurfelConfig)
    gaussians: GaussianConfig = field(default_factory=GaussianConfig)
    environment_map: EnvironmentMapConfig = field(default_factory=EnvironmentMapConfig)
    model_selection: ModelSelectionConfig = field(default_factory=ModelSelectionConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    watch: WatchConfig = field(default_factory=WatchConfig)


def gaussian_settings(gaussians: GaussianConfig, masked: bool) -> GaussianConfig:
    """Return the 3D branch's settings as they hold for a scene with or without masks (see Growth)."""
    densify = gaussians.densify
    if densify.by is Growth.GRADIENT:
        return gaussians
    if masked:
        return replace(gaussians, rates=replace(gaussians.rates, scale=densify.scale_rate, beta2=densify.beta2))
    most = min(densify.max_count, densify.unmasked_count)
    return replace(gaussians, densify=replace(densify, by=Growth.GRADIENT, max_count=most))
