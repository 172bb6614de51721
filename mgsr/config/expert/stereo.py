"""Options of the stereo matching inside masks (`mgsr.stereo`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.options import Angle, Count, NotNegative, Options, Positive, Range, Share, WholeNumber


@dataclass(frozen=True)
class MatchSettings(Options):
    """The cost and the search of PatchMatch: the fields of StereoSettings in kernels/stereo/stereo.h, in its order.

    Pixels are those of the reduced photographs. Source: Bleyer and others 2011.
    """

    radius: Annotated[int, Range(0, 4)] = 2  # samples of a patch on each side of its centre
    spacing: Positive = 1.25  # pixels between samples
    noise: Positive = 0.008  # sRGB 0..1; standard deviation of the image noise
    alike: Positive = 0.15  # sRGB 0..1; colour difference from the centre at which a sample weighs 0.6
    reach: Positive = 4.0  # pixels from the centre at which a sample weighs 0.6
    best: Annotated[int, Range(1, 8)] = 3  # best neighbours, whose mean correlation is the score
    cover: Share = 0.6  # least share of a patch that must show the object in a neighbour
    prior: NotNegative = 0.1  # loss in score of a depth that lies prior_reach pixels off the starting surface
    prior_reach: Positive = 3.5  # pixels; distance from the starting surface at which a depth loses the score `prior`
    search: Positive = 7.0  # pixels; random variation of depths in the first round
    rounds: WholeNumber = 3  # rounds of the search


@dataclass(frozen=True)
class PatchMatchOptions(Options):
    """The choice of neighbours and depths that a photograph is matched with."""

    neighbours: Count = 8  # number of views that each view is matched with
    best_angle: Angle = 20.0  # degrees to the best neighbour, as seen from the scene's centre
    max_angle: Angle = 60.0  # degrees; views at a larger angle are no neighbours
    half_depth: Positive = 1.1  # scene units; half the depth around the scene's centre that is searched
    settings: MatchSettings = field(default_factory=MatchSettings)


@dataclass(frozen=True)
class ConsistencyOptions(Options):
    """The geometric consistency of depth maps, which gives their weights. Source: Schönberger and others 2016."""

    views: Count = 12  # number of nearest views that may confirm a depth
    max_angle: Angle = 60.0  # degrees; views at a larger angle confirm nothing
    min_confirming: WholeNumber = 2  # least number of views that must confirm a depth
    same_depth: Positive = 2.0  # pixels; largest difference of depths that confirm each other
    seen_through: Positive = 4.0  # pixels; a view that sees farther than this behind a point contradicts it
    same_normal: Angle = 40.0  # degrees; largest angle between normals that confirm each other
    worthless: Share = 0.2  # score below which a depth has the least weight
    perfect: Share = 0.8  # score from which a depth has the full weight; must exceed worthless
    least: Share = 0.05  # weight of a confirmed depth with a worthless score

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("worthless", "perfect")


@dataclass(frozen=True)
class FusionOptions(Options):
    """The fusion of depth maps into one surface. Source: Zach 2008, with votes of the visual hull."""

    resolution: Count = 192  # most voxels along the hull's longest side
    finest: Positive = 0.7  # pixels; least size of a voxel
    coarser: Count = 2  # edge length of a voxel in the first, coarse fusion, in fine voxels; the fine fusion keeps to a
    # band around the coarse surface
    band: Share = 0.9  # half the width of that band, in multiples of reach
    reach: Positive = 3.0  # pixels; truncation of the signed distances
    bins: Count = 12  # number of bins of the histogram, from -reach to reach
    hull_weight: NotNegative = 0.5  # weight of the hull's vote near its surface; a photograph's vote weighs 0 to 1
    hull_floor: NotNegative = 0.02  # weight of the hull's vote deep inside
    thin: Positive = 2.0  # thickness of the hull, in multiples of reach, below which its vote weighs more
    thinnest: Annotated[float, Range(0, 1, open=True)] = 0.2  # share of `thin`; in still thinner places the weight of
    # the hull's vote stays constant
    fading: Positive = 2.0  # depth inside the hull, in multiples of reach, over which its vote falls to 1/e
    solid_weight: NotNegative = 0.05  # share of its weight with which a photograph votes for solid space more than
    # reach behind its surface
    solid_depth: Annotated[float, Range(1)] = 5.0  # depth behind the surface, in multiples of reach, at which these
    # votes end
    pooled: NotNegative = 1.0  # voxels; standard deviation of the Gaussian that pools the votes
    variation: Positive = 0.14  # weight of the total variation against votes of weight 1, in multiples of reach
    rounds: Count = 120  # iterations of the optimiser when it starts from the votes' median
    fine_rounds: Count = 40  # iterations of the optimiser when it starts from the coarse fusion
    smoothed: NotNegative = 0.5  # voxels; standard deviation of the Gaussian that smooths the final distances
    outside: NotNegative = 1.0  # voxels; distance outside its place at which the surface is extracted
    min_piece: Share = 0.02  # least area of a piece, as a share of the whole; smaller pieces are noise


@dataclass(frozen=True)
class StereoConfig(Options):
    """Stereo inside the masks."""

    max_object_pixels: Count = 1_200_000  # most pixels of the object in all photographs together; larger photographs
    # are reduced
    match: PatchMatchOptions = field(default_factory=PatchMatchOptions)
    consistency: ConsistencyOptions = field(default_factory=ConsistencyOptions)
    fusion: FusionOptions = field(default_factory=FusionOptions)
