"""Every setting with its default, unit and meaning. Only the command line, the service and the worker build these.

`make_config` puts a run's settings together: the defaults below, then the preset's row of PRESETS, then the method's
row of METHODS, then the caller's ``key=value`` overrides. ABLATIONS has the paper's rows as such overrides.
"""

from __future__ import annotations

import difflib
import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import StrEnum
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from mgsr.errors import ConfigError


class Masks(StrEnum):
    """What the masks beside photographs mean. auto: found out, and silhouettes are used where every view has one;
    object: white is the object, and every view needs a mask; ignore: black is what to leave out, such as passers-by;
    off: they are not used, and images with alpha are put on white."""

    AUTO = "auto"
    OBJECT = "object"
    IGNORE = "ignore"
    OFF = "off"


class Blurred(StrEnum):
    """keep: photographs that are much less sharp than their neighbours are used; drop: they are left out."""

    KEEP = "keep"
    DROP = "drop"


class Object(StrEnum):
    """What is reconstructed of a capture without masks. off: all that is seen. auto: the object that stands in the
    middle, if there is a single one, by masks that are found for it; else all that is seen."""

    OFF = "off"
    AUTO = "auto"


class Exposure(StrEnum):
    """auto: photographs whose exposures differ are brought to a common one; keep: they stay as they are."""

    AUTO = "auto"
    KEEP = "keep"


@dataclass(frozen=True)
class DataConfig:
    """How a capture is read."""

    masks: Masks = Masks.AUTO
    exposure: Exposure = Exposure.AUTO
    object: Object = Object.OFF
    object_box: str | None = None  # x0,y0,z0,x1,y1,z1 in the capture's frame and unit: between these corners lies the
    # object, of which masks are found then; none leaves it to `object`
    blurred: Blurred = Blurred.KEEP
    confined: bool = False  # look for nothing outside the folder that is given; jobs of the service always do so
    test_every: int = 8  # every n-th view is held out, where the files name no split
    max_side: int = 1600  # pixels; larger photographs are reduced to this by area means, before the lens is undone


class Extractor(StrEnum):
    """poisson: screened Poisson on oriented points; tsdf: fusion of depth maps (the paper's)."""

    POISSON = "poisson"
    TSDF = "tsdf"


class MeshColor(StrEnum):
    """The mesh's vertex colours: transmitted, without the highlights; full, the mean of all that the views show."""

    TRANSMITTED = "transmitted"
    FULL = "full"


@dataclass(frozen=True)
class MeshConfig:
    """How the surface is taken from the 2D branch. A footprint is what a pixel of the rendered views covers there."""

    extractor: Extractor = Extractor.POISSON
    view_scale: float = 2.0  # size of the rendered views against the photographs
    max_pixels: int = 16_000_000  # of all rendered views together; they are made smaller to keep to it
    extra_views: int = 0  # views rendered halfway between training views
    min_alpha: float = 0.5  # pixels under it show no surface
    min_cos: float = 0.3  # pixels seen at a more grazing angle are dropped
    max_jump: float | None = 3.0  # footprints off a neighbour's plane at which a pixel counts as blended; none is off
    radius: float | None = 1.25  # what lies farther from the scene's centre is dropped; none is off
    consistency: float | None = 3.0  # footprints in front of another view's surface that are forgiven; none is off
    hull_margin: float | None = 1.0  # pixels outside a photograph's silhouette that are forgiven; none is off
    hull_reach: float = 4.0  # footprints that vertices are pulled into the silhouettes at most; others are cut off
    outline_smoothing: float | None = 1.0  # pixels over which a correction of the outlines spreads; none is off
    poisson_depth: int = 8  # of the octree; its finest cell is 1.1 / 2^depth of the object's longest side
    cell: float = 0.6  # octree cells in which points are averaged into one
    trim: float = 3.0  # octree cells from the nearest point at which Poisson's surface is cut
    shading_ratio: float | None = 0.85  # a flash on the camera, or mirrored surroundings, count as known where they
    # leave at most this share of what one brightness a point leaves; the mesh then heeds them; none is off, for
    # parallax too
    parallax_reach: float | None = 8.0  # pixels over which what the photographs' parallax tells spreads, where
    # shading is looked at and masks hold the outlines; none is off
    disagreement: float | None = 0.022  # sRGB 0..1 by which photographs under a flash differ about a place, beyond what
    # a surface that is 0.7 pixels off explains, at which it is left open; none, or close_holes, keeps all
    wave_angle: float | None = 4.0  # degrees; normals that differ by less within a few pixels are taken for waves, by
    # much more for a crease, unless a flash has told them; none and 0 are off
    smoothing_angle: float | None = 17.0  # degrees; normals of neighbouring facets that differ by less are taken for
    # noise, by much more for a crease; none and 0 are off
    voxel: float = 2.0  # footprints in a voxel of the TSDF
    truncation: float = 3.0  # voxels before and behind the surface that the TSDF reaches
    min_weight: float = 2.0  # views in which a voxel of the TSDF must be seen
    min_piece: float = 0.01  # connected pieces under this share of the area are dropped
    close_holes: bool = False  # keep what Poisson invents where nothing was seen
    max_faces: int | None = None  # decimate to this many; none is off
    color: MeshColor = MeshColor.TRANSMITTED


class Up(StrEnum):
    """Which axis of the capture's frame points up: y, z, -y, -z, or auto, what most photographs have as their upper
    side. .glb files are y up, and are turned to it."""

    AUTO = "auto"
    Y = "y"
    Z = "z"
    MINUS_Y = "-y"
    MINUS_Z = "-z"


@dataclass(frozen=True)
class OutputConfig:
    """Which files are written, and in which unit and pose."""

    scale: float = 1.0  # what all lengths in the written files are multiplied with; 1 is the capture's own unit
    up: Up = Up.AUTO
    obj: bool = False  # mesh.obj too
    texture: int | None = None  # texels along a side of the picture of mesh_textured.glb; none writes no such file
    texture_faces: int | None = (
        50_000  # decimate mesh_textured.glb to this many, as its picture shows the rest; none is off
    )


class Branches(StrEnum):
    """Which branches are trained. With one alone the mutual phase goes on with that branch's own loss."""

    BOTH = "both"
    SURFELS = "surfels"
    VOLUMES = "volumes"


class StopRule(StrEnum):
    """When a warm-up ends before its iterations are spent.

    epoch: the mean loss over all views hardly falls from one span of epochs to the next. held_back: the PSNR of a
    few training views that the warm-up never sees stops rising. paper: the last 100 losses lie within a range
    (they come from different views, so this compares unlike things). none: never.
    """

    EPOCH = "epoch"
    HELD_BACK = "held_back"
    PAPER = "paper"
    NONE = "none"


class Teaching(StrEnum):
    """Which branch the two mutual losses change: both, or (Model K) only the one that is being taught."""

    BOTH_WAYS = "both_ways"
    ONE_WAY = "one_way"


class DepthUnit(StrEnum):
    """What divides both depths in the mutual depth loss: the camera's distance from the scene's centre, which is the
    same in every iteration, or the 3D depth's maximum (the paper's, which one far floater changes)."""

    DISTANCE = "distance"
    MAXIMUM = "maximum"


class SurfaceDepth(StrEnum):
    """Which depth of the 2D branch is the surface: the blend's mean, or where half the light is gone."""

    EXPECTED = "expected"
    MEDIAN = "median"


class Background(StrEnum):
    """What lies behind the splats in training. auto: random where there are masks, else the colour of a plain backdrop
    where photographs have one (outlines are then learned), and white."""

    AUTO = "auto"
    RANDOM = "random"
    WHITE = "white"
    BLACK = "black"


class AlphaLoss(StrEnum):
    """How the rendered alpha is compared with the mask: mean absolute difference, or binary cross-entropy."""

    L1 = "l1"
    BCE = "bce"


@dataclass(frozen=True)
class RatesConfig:
    """Learning rates, a step of Adam each. The position's fades exponentially over the whole run; the others stay for
    a while, in which colours and shapes find their place, and fade then, which settles them.

    The published rates are for 30,000 iterations; these are for some thousands."""

    position: float = 4e-4  # times the scene's extent, at the start; published 1.6e-4
    position_end: float = 4e-6  # times the scene's extent, at the end; published 1.6e-6
    sh: float = 1e-2  # the constant term of colour; published 2.5e-3
    sh_rest: float = 4e-3  # the direction-dependent terms; published 1.25e-4
    opacity: float = 5e-2
    weight: float = 5e-2  # the reflection weight's logit
    scale: float = 1e-2  # log-scale; published 5e-3
    rotation: float = 4e-3  # published 1e-3
    fade_from: float = 0.5  # fraction of the run after which the other rates begin to fade
    final: float = 0.1  # factor that they have reached at the end; published 1
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
    drop_carrying: float = 0.06  # share of the light; splats that together carry less go after the warm-up; masked
    # scenes only: in others a few huge ones in the background carry most of it


@dataclass(frozen=True)
class VolumeDensifyConfig(DensifyConfig):
    """How the 3D branch gains and loses Gaussians: as DensifyConfig says, or by the errors of its renderings."""

    by: Growth = Growth.ERROR
    tolerance: float = 0.04  # mean over 3 x 3 pixels of the difference, sRGB 0..1, from which it counts as visible
    growth: float = 0.5  # largest share of the count that is added in one round
    replace: float = 0.1  # largest share of the count that is replaced in one round: those that carry least light
    growth_views: int = 8  # training views that are rendered in one round
    new_opacity: float = 0.6  # of Gaussians that are added by errors
    scale_rate: float = 2e-2  # learning rate of log-scales, in place of rates.scale, where errors tell
    beta2: float = 0.99  # of Adam, in place of rates.beta2, where errors tell
    unmasked_count: int = 20_000  # max_count where the gradient tells because there are no masks
    prune_opacity: float = 0.005
    max_count: int = 1_000_000
    drop_carrying: float = 0.01


@dataclass(frozen=True)
class SurfelConfig:
    """The 2D branch: the surface."""

    sh_degree: int = 2  # more lets colour explain what the shape should
    max_start: int = 16_000  # splats; more starting points are thinned to this, by the seed
    start_opacity: float = 0.9
    start_scale: float = 0.4  # times the mean distance of the three nearest neighbours; wide disks stand off curves
    depth: SurfaceDepth = SurfaceDepth.MEDIAN
    normal_weight: float = 0.05  # lambda_3: rendered normal against the depth's, times normal_tv_weight too
    normal_tv_weight: float = 1.0  # lambda_4
    depth_tv_weight: float = 0.1  # lambda_5; the paper's 1 flattens and shrinks
    distortion_weight: float = 0.0  # 2DGS's; the method has none
    alpha_weight: float = 0.1  # alpha against the mask; masked scenes only
    edge_band: int = 4  # pixels on either side of the mask's outline where this branch is not judged: there the soft
    # edges of splats would be paid for by a smaller object
    regularise_from: float = 0.0  # fraction of the warm-up after which lambda_3 to lambda_5 count
    # Positions move slowly: from near the surface, faster ones drift behind it (by half a pixel on shiny scenes).
    rates: RatesConfig = field(
        default_factory=lambda: RatesConfig(position=5e-5, position_end=5e-6, sh_rest=2e-3, scale=5e-3)
    )
    densify: DensifyConfig = field(default_factory=lambda: DensifyConfig(max_count=20_000))


class Reflection(StrEnum):
    """What the 3D branch adds to the transmitted light. auto: a trial decides (see TrialConfig).

    off: nothing (3DGS). own: each splat's reflected colour, times its weight (the paper's). shared: two maps, the same
    for all splats, of the light that the 2D branch's surface mirrors. both: the maps added to the splats' own.
    """

    AUTO = "auto"
    OFF = "off"
    OWN = "own"
    SHARED = "shared"
    BOTH = "both"


@dataclass(frozen=True)
class VolumeConfig:
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
    depth_tv_weight: float = 0.0  # the published program has 0.05
    reflected_cost: float = 0.15  # on the mean of W * C_ref: what the transmitted light can explain, it must
    alpha_weight: float = 0.1  # alpha against the mask; masked scenes only
    rates: RatesConfig = field(default_factory=RatesConfig)
    densify: VolumeDensifyConfig = field(default_factory=VolumeDensifyConfig)


@dataclass(frozen=True)
class MirrorConfig:
    """The maps of the light that the surface mirrors (see Reflection)."""

    side: int = 64  # texels along a map's side
    start: float = 0.007  # the maps' light, 0..1
    rate: float = 0.03  # learning rate of the light's logits
    fade_from: float = 0.5  # fraction of the run after which the rate begins to fade
    final: float = 0.1  # factor that it has reached at the end
    smoothness: float = 0.05  # weight of the mean square of differences between neighbouring texels
    iterations: int = 300  # of the 3D branch and the light after the surface was made, which then mirrors instead of
    # the 2D branch; masked scenes only; 0 is never
    weight_hold: float = 5e-7  # pull of each splat's reflection weight to its start


@dataclass(frozen=True)
class TrialConfig:
    """The 3D branch warms up without any reflection. Then each of off and shared, or of off and own where no surface
    mirrors, goes on from there for a while, and off stays unless the other renders photographs kept from training
    better; lower degrees of the transmitted colour's harmonics stay as long as they are no worse.

    Without iterations, or with too few photographs, the start decides: off where brightness does not change from view
    to view as mirrored light does, shared where it does, both where that is not known.
    """

    start: float = 0.5  # fraction of the 3D branch's warm-up that comes before
    iterations: int = 150  # of each; 0 is no trial
    views: int = 6  # training photographs kept from the warm-up until the trial is over; at most a quarter
    gain: float = 0.1  # dB that a less simple one must render better


@dataclass(frozen=True)
class WarmupConfig:
    """Each branch alone (supplement, Algorithm 1)."""

    surfel_iterations: int = 800  # at most
    volume_iterations: int = 2000  # at most
    coarse: float = 0.4  # fraction of the iterations on photographs of half the size; never the trial's
    coarse_side: int = 400  # pixels; photographs whose shorter side is smaller are not made smaller still
    stop_rule: StopRule = StopRule.EPOCH
    stop_after: float = 0.75  # fraction of the iterations before which no branch stops
    epoch_span: int = 5  # epochs that are averaged and compared with as many before them
    epoch_gain: float = 0.002  # relative fall of the loss under which a branch has converged
    held_back_views: int = 3  # training views kept out of the warm-up under the rule held_back
    held_back_every: int = 100  # iterations between looks at them
    held_back_patience: int = 4  # looks without a gain
    held_back_gain: float = 0.05  # dB
    paper_range: float = 0.01  # of the last 100 losses


@dataclass(frozen=True)
class MutualConfig:
    """Both branches teach each other (supplement, Algorithm 2)."""

    iterations: int = 1600
    iterations_factor: float = 1.0  # times `iterations`; Models G to J
    surfel_weight: float = 0.5  # of L_2D in the total
    volume_weight: float = 0.5  # of L_3D in the total
    depth_weight: float = 0.01  # of L_depth in the total
    photo_weight: float = 0.3  # lambda_6: the photograph's share in the 2D branch's target; the rest is C_tran's
    teaching: Teaching = Teaching.BOTH_WAYS
    depth_unit: DepthUnit = DepthUnit.DISTANCE


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
    tv: bool = True  # off: every TV weight counts as zero (Model N)
    flash: bool = True  # where the start finds one, splats hold colours as under even light, which it then lights
    background: Background = Background.AUTO
    alpha_loss: AlphaLoss = AlphaLoss.L1
    crop_margin: int | None = 16  # pixels around the mask's box that the photographic losses see; none is the image
    clearance: float = 0.5  # share of the way from a training camera to the nearest starting points in which no splats
    # may lie; scenes without masks only; 0 is none
    sh_step: float = 0.02  # fraction of the warm-up between two rises of the SH degree
    warmup: WarmupConfig = field(default_factory=WarmupConfig)
    mutual: MutualConfig = field(default_factory=MutualConfig)
    surfels: SurfelConfig = field(default_factory=SurfelConfig)
    volumes: VolumeConfig = field(default_factory=VolumeConfig)
    mirror: MirrorConfig = field(default_factory=MirrorConfig)
    trial: TrialConfig = field(default_factory=TrialConfig)
    watch: WatchConfig = field(default_factory=WatchConfig)


@dataclass(frozen=True)
class Config:
    """One run."""

    preset: str = "standard"
    method: str = "mgsr"
    seed: int = 0
    time_budget: float | None = None  # seconds near which the whole run ends; the settings that presets change, and the
    # size of the photographs, are then planned for it; none is as long as it takes
    data: DataConfig = field(default_factory=DataConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    mesh: MeshConfig = field(default_factory=MeshConfig)
    output: OutputConfig = field(default_factory=OutputConfig)


# What each preset changes; times are for 48 views at 256 x 256 on two cores, with the meshing. Slow cores take up to
# twice as long.
PRESETS: dict[str, dict[str, str]] = {
    "draft": {  # 25 to 50 seconds
        "warmup.surfel_iterations": "250",
        "warmup.volume_iterations": "300",
        "mutual.iterations": "200",
        "trial.iterations": "0",
        "mirror.iterations": "100",
        "surfels.max_start": "9000",
        "surfels.start_scale": "0.5",
        "volumes.max_start": "5000",
        "volumes.sh_degree": "1",  # to which a trial comes, where there is time for one
        "surfels.densify.max_count": "10000",
        "volumes.densify.unmasked_count": "8000",
        "surfels.densify.drop_carrying": "0",  # so short a mutual phase does not mend what goes
        "volumes.densify.drop_carrying": "0",
        "mesh.view_scale": "1.0",
        "mesh.poisson_depth": "7",
        "mesh.shading_ratio": "none",  # the start is bent to the shading already, and little training follows
    },
    "standard": {},  # two to three minutes
    "high": {  # up to a fifth longer; training that lasts longer makes surfaces rougher, and renders hardly better
        "surfels.max_start": "32000",
        "surfels.densify.max_count": "40000",
        "volumes.max_start": "20000",
        "volumes.densify.tolerance": "0.02",
        "volumes.densify.unmasked_count": "40000",
    },
}

METHODS: dict[str, dict[str, str]] = {
    "mgsr": {},
    "2dgs": {"branches": "surfels", "flash": "off"},
    "3dgs": {
        "branches": "volumes",
        "reflection": "off",
        "flash": "off",
        "volumes.sh_degree": "3",
        "transmitted_tv_weight": "0",
        "volumes.densify.by": "gradient",
        "volumes.densify.drop_carrying": "0",
    },
}

# The supplement's rows. E, I and M are the method itself; the published weights of C, D and F are not known.
ABLATIONS: dict[str, dict[str, str]] = {
    "A": {"branches": "volumes", "reflection": "own", "flash": "off"},
    "B": {"branches": "surfels", "flash": "off"},
    "C": {"surfel_weight": "0.25", "volume_weight": "0.75"},
    "D": {"surfel_weight": "0.75", "volume_weight": "0.25"},
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


def make_config(
    preset: str = "standard",
    method: str = "mgsr",
    seed: int = 0,
    overrides: Mapping[str, object] | Sequence[str] = (),
) -> Config:
    """One run's settings from a preset, a method and overrides, applied in that order.

    overrides: settings by name, such as ``{"masks": "off", "mesh.max_faces": 50_000}``, or ``key=value`` texts.

    A key is a field's full path (``train.mutual.depth_weight``) or any part of it that names one field alone
    (``masks``, ``surfels.densify.every``). Values are read as the field's type; ``none`` where the field allows it.

    Raises ConfigError for an unknown preset, method, key or value, naming what was meant perhaps.
    """
    config = Config(preset=_known("preset", preset, PRESETS), method=_known("method", method, METHODS), seed=seed)
    for row in (PRESETS[preset], METHODS[method]):
        config = apply_overrides(config, [f"{key}={value}" for key, value in row.items()])
    config = apply_overrides(config, override_texts(overrides))
    validate(config)
    return config


def override_texts(overrides: Mapping[str, object] | Sequence[str]) -> list[str]:
    """Return overrides as ``key=value`` texts. Raises ConfigError for a single text in place of several."""
    if isinstance(overrides, str):
        raise ConfigError(f"overrides: expected settings by name, or several key=value texts, got {overrides!r}")
    if not isinstance(overrides, Mapping):
        return list(overrides)
    return [f"{key}={_text(value)}" for key, value in overrides.items()]


def _text(value: object) -> str:
    """Return a setting's value as `_parse` reads it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return "none" if value is None else str(value)


def ablation_overrides(row: str) -> list[str]:
    """Return the ``key=value`` overrides of one ablation row, A to N. Raises ConfigError for another name."""
    return [f"{key}={value}" for key, value in ABLATIONS[_known("ablation", row, ABLATIONS)].items()]


def apply_overrides(config: Config, overrides: Sequence[str]) -> Config:
    """Return the configuration with ``key=value`` pairs set, later ones last. Raises ConfigError as `make_config`."""
    paths = field_types(config)
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise ConfigError(f"--set {override}: expected key=value, for example masks=off")
        path = _find_path(key.strip(), list(paths))
        config = _replaced(config, path.split("."), _parse(path, text.strip(), paths[path]))
    return config


def field_types(config: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted path and type of every plain field of a nested dataclass."""
    hints = get_type_hints(type(config))
    found: dict[str, Any] = {}
    for item in fields(config):
        value, path = getattr(config, item.name), prefix + item.name
        found.update(field_types(value, path + ".") if is_dataclass(value) else {path: hints[item.name]})
    return found


def volume_settings(volumes: VolumeConfig, masked: bool) -> VolumeConfig:
    """Return the 3D branch's settings as they hold for a scene with or without masks (see Growth)."""
    densify = volumes.densify
    if densify.by is Growth.GRADIENT:
        return volumes
    if masked:
        return replace(volumes, rates=replace(volumes.rates, scale=densify.scale_rate, beta2=densify.beta2))
    most = min(densify.max_count, densify.unmasked_count)
    return replace(volumes, densify=replace(densify, by=Growth.GRADIENT, max_count=most))


def validate(config: Config) -> None:
    """Raise ConfigError for values that parse but can't work together."""
    train = config.train
    for path in field_types(config):
        value = _value(config, path)
        if isinstance(value, (int, float)) and not 0 <= value < math.inf:
            raise ConfigError(f"{path}: expected a finite number, 0 or more, got {value}")
    _validate_output(config.output)
    object_box(config.data.object_box)
    for path, degree in (
        ("train.surfels.sh_degree", train.surfels.sh_degree),
        ("train.volumes.sh_degree", train.volumes.sh_degree),
        ("train.volumes.reflected_sh_degree", train.volumes.reflected_sh_degree),
    ):
        if degree > 3:
            raise ConfigError(f"{path}: expected 0 to 3, got {degree}")
    between = ("surfels.start_opacity", "volumes.start_opacity", "volumes.start_weight", "mirror.start")
    for path in (*between, "volumes.densify.new_opacity"):
        if not 0 < _value(config, "train." + path) < 1:
            raise ConfigError(f"train.{path}: expected a value between 0 and 1, got {_value(config, 'train.' + path)}")
    if train.branches is not Branches.BOTH and train.volumes.reflection in (Reflection.SHARED, Reflection.BOTH):
        kind = train.volumes.reflection
        raise ConfigError(f"train.volumes.reflection={kind}: needs both branches, got train.branches={train.branches}")
    if train.warmup.coarse > train.trial.start:
        raise ConfigError(
            f"train.warmup.coarse: expected at most train.trial.start ({train.trial.start}), since a trial looks at "
            f"whole photographs; got {train.warmup.coarse}"
        )
    if train.trial.start > train.warmup.stop_after:
        raise ConfigError(
            f"train.trial.start: expected at most train.warmup.stop_after ({train.warmup.stop_after}), before which no "
            f"warm-up ends; got {train.trial.start}"
        )
    for path in field_types(config):
        if ".rates." in path and _value(config, path) == 0:
            raise ConfigError(f"{path}: expected more than 0, got 0; 1e-12 holds a parameter still")
        if path == "time_budget" and _value(config, path) == 0:
            raise ConfigError(f"{path}: expected more than 0 seconds, got 0")
        if path.endswith("drop_carrying") and _value(config, path) >= 1:
            raise ConfigError(f"{path}: expected a share below 1, got {_value(config, path):g}")
        if path.endswith(("every", "epoch_span")) and _value(config, path) == 0:
            raise ConfigError(f"{path}: expected at least 1, got 0")


def object_box(text: str | None) -> np.ndarray | None:
    """Return the corners [2,3] of a box that text names as six numbers, the least corner first; None for None.

    Raises ConfigError for other texts.
    """
    if text is None:
        return None
    try:
        corners = np.array([float(part) for part in text.split(",")]).reshape(2, 3)
    except ValueError:
        corners = np.zeros((2, 3))
    if not (np.isfinite(corners).all() and (corners[0] < corners[1]).all()):
        raise ConfigError(
            f"data.object_box: expected x0,y0,z0,x1,y1,z1 with x0 < x1, y0 < y1 and z0 < z1, got {text!r}"
        )
    return corners


def _validate_output(output: OutputConfig) -> None:
    if not (math.isfinite(output.scale) and output.scale > 0):
        raise ConfigError(f"output.scale: expected a number above 0, got {output.scale:g}")
    if output.texture is not None and not 16 <= output.texture <= 16384:
        raise ConfigError(f"output.texture: expected 16 to 16384 texels, got {output.texture}")
    if output.texture_faces is not None and output.texture_faces < 100:
        raise ConfigError(f"output.texture_faces: expected at least 100, got {output.texture_faces}")


def _known(kind: str, name: str, table: Mapping[str, Any]) -> str:
    if name not in table:
        raise ConfigError(f"{kind} {name!r}: expected one of {', '.join(table)}")
    return name


def _find_path(key: str, paths: list[str]) -> str:
    """Return the one field that a key names: its full path, or parts of it in order that end in the field's name."""
    if key in paths:
        return key
    parts = key.split(".")
    hits = [path for path in paths if path.split(".")[-1] == parts[-1] and _in_order(parts, path.split("."))]
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise ConfigError(f"option {key!r} is ambiguous: say one of {', '.join(hits)}")
    names = {".".join(path.split(".")[-len(parts) :]): path for path in paths}
    near = [names[name] for name in difflib.get_close_matches(key, names, n=3, cutoff=0.5)]
    hint = f"; did you mean {', '.join(near)}?" if near else f"; top sections are {', '.join(_sections(paths))}"
    raise ConfigError(f"option {key!r} does not exist{hint}")


def _in_order(parts: list[str], path: list[str]) -> bool:
    rest = iter(path)
    return all(part in rest for part in parts)


def _sections(paths: list[str]) -> list[str]:
    return sorted({path.split(".")[0] for path in paths})


def _parse(path: str, text: str, kind: Any) -> Any:
    """Return the text as a value of the field's type."""
    if get_origin(kind) in (Union, types.UnionType):
        if text.lower() == "none":
            return None
        kind = next(part for part in get_args(kind) if part is not type(None))
    if kind is bool:
        return _parse_switch(path, text)
    try:
        return kind(text)
    except ValueError as error:
        raise ConfigError(f"{path}: expected {_expected(kind)}, got {text!r}") from error


def _parse_switch(path: str, text: str) -> bool:
    switches = {"on": True, "true": True, "yes": True, "1": True, "off": False, "false": False, "no": False, "0": False}
    if text.lower() not in switches:
        raise ConfigError(f"{path}: expected on or off, got {text!r}")
    return switches[text.lower()]


def _expected(kind: Any) -> str:
    if issubclass(kind, StrEnum):
        return "one of " + ", ".join(kind)
    words: str = {int: "a whole number", float: "a number"}.get(kind, kind.__name__)
    return words


def _replaced(node: Any, path: list[str], value: Any) -> Any:
    head, *rest = path
    return replace(node, **{head: _replaced(getattr(node, head), rest, value) if rest else value})


def _value(node: Any, path: str) -> Any:
    for part in path.split("."):
        node = getattr(node, part)
    return node
