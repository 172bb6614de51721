"""Options of the search for the object in captures without masks (`mgsr.segmentation`).

A ball radius is the unit of the scene's frame. Colours are sRGB 0..1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.options import Angle, Count, NotNegative, Options, Positive, Range, Share, WholeNumber


@dataclass(frozen=True)
class SupportPlaneOptions(Options):
    """The search for the plane that an object stands on. Source: RANSAC, Fischler and Bolles 1981."""

    trials: Count = 3000  # planes through three random points
    max_tilt: Angle = 35.0  # degrees; largest angle between the plane's normal and the cameras' mean upward direction
    refits: WholeNumber = 5  # least-squares fits to the inliers
    min_inliers: Share = 0.1  # least share of the points that are inliers
    min_above: Share = 0.8  # least share of the cameras above the plane
    max_below: Share = 0.25  # largest share of the points below the plane


@dataclass(frozen=True)
class BackgroundRenderOptions(Options):
    """The image-based rendering of the background, and its photo-consistency."""

    cameras: Count = 24  # other photographs to sample, the most similar viewing directions first
    samples: Count = 9  # number of colours that are collected for a pixel
    min_samples: Count = 2  # least number of colours; with fewer, the background counts as unknown
    agreeing: Count = 2  # number of photographs that must show a colour at a place before it is photo-consistent
    test_height: Positive = 0.05  # ball radii; least height above the support plane at which a pixel's ray is tested
    tests: Count = 4  # number of heights at which a pixel's ray is tested; each is twice the previous one
    covered: Share = 0.3  # rendered opacity above which surfels form a surface
    plane_radius: Positive = 4.0  # ball radii around the scene's centre within which the support plane is visible
    plane_first: Positive = 1.05  # factor on the surfels' depth; the plane is visible if its depth is less than the
    # product
    far: Positive = 20.0  # ball radii; camera z of a pixel whose ray meets no surface


@dataclass(frozen=True)
class TolerantHullOptions(Options):
    """The visual hull that tolerates errors in single masks."""

    resolution: Annotated[int, Range(2)] = 128  # voxels along a side
    half: Positive = 0.6  # half the side of the carved cube, as a share of the box's longest side
    sunk: NotNegative = 1.0  # pixels; depth below the support plane at which the hull ends


@dataclass(frozen=True)
class RandomWalkerOptions(Options):
    """The random walker that turns costs into a matte. Source: Grady 2005."""

    smoothness: NotNegative = 6.0  # weight of an edge between pixels of equal colour, relative to the costs
    contrast: Positive = 0.05  # sRGB 0..1; colour difference that reduces an edge's weight to 0.6 times the weight of
    # equal colours
    tolerance: Positive = 1e-3  # relative residual at which the conjugate gradient solver stops
    iterations: Count = 300  # most iterations of the solver


@dataclass(frozen=True)
class ColorModelOptions(Options):
    """The colour models of the object and of the support plane, which judge places that no photograph shows clearly."""

    samples: Count = 20_000  # number of colours that are drawn for each model
    neighbours: Count = 20  # rank of the nearest sample whose distance counts
    deviation: Positive = 0.015  # standard deviation of a colour from its model
    reach: Positive = 1.0  # radius around the object's middle within which the plane is sampled, in diagonals of the
    # object's box
    shades: Count = 4  # number of copies of the plane's colours, from full to least brightness, for contact shadows
    darkest: Share = 0.75  # least brightness, as a factor of the sRGB values


@dataclass(frozen=True)
class MatteOptions(Options):
    """The mattes of the object. A cost is a squared colour difference over twice a variance."""

    noise: Positive = 0.02  # standard deviation of a photograph from its known background
    spread: NotNegative = 1.5  # factor on the spread of the background's samples, which adds to the noise
    guessed: Positive = 0.06  # standard deviation where the background is extrapolated, or where only photo-consistency
    # decides
    unsure: NotNegative = 2.0  # additional cost of a known background whose standard deviation is e times that of a
    # guessed one: a background that may have any colour explains no colour well
    rendered: Positive = 0.04  # standard deviation of a photograph from the object's rendered surfels
    max_cost: Positive = 9.0  # upper limit of a cost
    certain_cost: NotNegative = 4.0  # background cost above which a pixel certainly does not show the background
    deep: NotNegative = 3.0  # pixels inside the hull's silhouette beyond which the label background costs more
    deep_cost: NotNegative = 6.0  # additional cost of the label background there, where the background is known
    gap_cost: NotNegative = 3.0  # difference of the costs of object and background above which a pixel may belong to a
    # gap in the hull's silhouette: neither the deep cost nor `filled` applies there
    outside: NotNegative = 3.0  # pixels outside the hull's silhouette beyond which the label object costs more
    outside_cost: NotNegative = 3.0  # additional cost of the label object there
    searched: NotNegative = 6.0  # pixels around the hull's silhouette in which the object may lie
    first_searched: NotNegative = 0.12  # distance from the first mask within which the object may lie, as a share
    # of the square root of the mask's area
    max_hole: Share = 0.005  # area of a hole, as a share of the mask's, below which it is filled: highlights look like
    # background
    margin: WholeNumber = 4  # pixels by which the processed window exceeds the region
    scales: Count = 5  # number of Gaussian blurs by which colours are extended: of 1 pixel, 2 pixels, 4 pixels and so
    # on
    min_weight: Share = 0.1  # blurred weight above which an extended colour counts
    walker: RandomWalkerOptions = field(default_factory=RandomWalkerOptions)


@dataclass(frozen=True)
class ObjectSearchOptions(Options):
    """The search for the object's surfels and masks. Its pixels are those of the small photographs, on the object."""

    side: Count = 480  # pixels; longer side of the small photographs, for training and for the search
    fine_side: Count = 960  # pixels; longer side of the photographs for the final masks
    iterations: Count = 800  # iterations of the training
    rounds: Count = 3  # rounds of refining masks, hull and surfels
    first_dissent: Share = 0.1  # share of the masks that may exclude a place of the hull, in the first round
    last_dissent: Share = 0.06  # share of the masks that may exclude a place of the hull, in the last round
    solid: Share = 0.2  # least opacity of the object's first surfels
    near: Positive = 1.5  # ball radii; distance from the scene's centre within which most of the object stands
    farthest: Positive = 3.0  # ball radii; distance from the scene's centre that no part of the object exceeds
    mostly_near: Share = (
        0.5  # least share of the object's first surfels that are near; otherwise the others are cut off
    )
    middle: Positive = 0.7  # ball radii; distance from the middle at which a surfel's vote for its piece falls to 1/e
    flat: Positive = 3.0  # pixels; tolerance of the support plane's inliers, and margin of a given box
    standing: NotNegative = 6.0  # pixels; least height of the object's first surfels above the plane
    raised: NotNegative = 3.0  # pixels; least height of the object's later surfels above the plane
    reflected: NotNegative = 3.0  # pixels; depth below the plane beyond which a surfel is a reflection, not background
    around: NotNegative = 1.5  # pixels; distance from the hull within which a surfel may be the object's
    copies: Count = 8  # copies of a surfel between its place and the plane, which fill the first masks
    linked: Positive = 2.5  # times the median distance to a third neighbour; surfels closer than this are connected
    blocked: WholeNumber = 2  # pixels around a mask that do not count as background
    certain: Share = 0.5  # least share of an object surfel's pixels with known background that certainly hide it
    known: Share = 0.03  # least share of an object surfel's pixels whose background is known
    min_surfels: Annotated[int, Range(4)] = 50  # least surfels of an object
    rival: NotNegative = 0.4  # relative size of a second piece above which the object is ambiguous
    outer_margin: NotNegative = 1.5  # pixels outside the hull's silhouette beyond which final masks are 0
    filled: NotNegative = 2.0  # pixels inside the hull's silhouette beyond which final masks are 1, except in gaps
    min_agreement: Share = 0.75  # least mean intersection over union of the masks and the hull's silhouettes
    min_shown: Share = 0.8  # least share of the photographs that show the object
    full: Share = 0.7  # median share of the image above which masks do not show a single object
    cut: NotNegative = 0.1  # ratio of the mask's pixels on the image's border to the square root of its area, above
    # which the image cuts the object off
    max_cut: Share = 0.5  # largest share of the photographs that cut the object off


@dataclass(frozen=True)
class SegmentationConfig(Options):
    """The search for the object in captures without masks."""

    search: ObjectSearchOptions = field(default_factory=ObjectSearchOptions)
    plane: SupportPlaneOptions = field(default_factory=SupportPlaneOptions)
    background: BackgroundRenderOptions = field(default_factory=BackgroundRenderOptions)
    hull: TolerantHullOptions = field(default_factory=TolerantHullOptions)
    mattes: MatteOptions = field(default_factory=MatteOptions)
    colors: ColorModelOptions = field(default_factory=ColorModelOptions)
