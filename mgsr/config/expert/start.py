"""Options of the starting points and of the first surface (`mgsr.start`).

The scene's ball has the radius 1 around its centre. Pixels are those of the photographs on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.expert.shading import ShadingPass
from mgsr.config.options import Angle, Count, NotNegative, Options, Positive, Range, Share, WholeNumber


@dataclass(frozen=True)
class FirstSurfaceOptions(Options):
    """The first surface of a masked object, inside its visual hull.

    The large shape of a hull is wrong too, so shading may change larger shape than on a trained surface. Deep
    concavities need many rounds. An environment map hardly constrains a hull's steps, which bilateral filtering removes
    between the rounds. It constrains the small shape better once photometric refinement has corrected the large shape.
    """

    max_hull_residual: NotNegative = (
        0.9  # the surface is a mirror if the hull's residual under an environment map is at
    )
    # most this share of stereo's
    disbelieved: Positive = 0.3  # octaves by which stereo's residual may exceed the hull's before its depths lose all
    # weight
    coarse_scale: Annotated[float, Range(0, 1, open=True)] = 0.5  # of the photographs' sides for the coarser stereo
    coarse_weight: Share = 0.3  # of the coarser stereo's depths, in gaps of the finer one's; those of the finer: 1
    photometric_reach: Positive = 5.0  # pixels over which the photometric refinement spreads a displacement
    flash_coarse: ShadingPass = field(default_factory=lambda: ShadingPass(edge=2.0, rounds=6, reach=160.0))
    flash_fine: ShadingPass = field(default_factory=lambda: ShadingPass(edge=1.5, rounds=3, reach=60.0))
    max_bent_residual: NotNegative = 0.94  # largest residual under an environment map after shape from shading, as a
    # share of that before; with more, brightness differs for other reasons, and the surface stays
    environment_repeats: Count = 3  # times that the pass environment_coarse is run
    environment_coarse: ShadingPass = field(default_factory=lambda: ShadingPass(3.0, 2, 240.0, bilateral_angle=17.0))
    environment_medium: ShadingPass = field(default_factory=lambda: ShadingPass(2.0, 2, 240.0, bilateral_angle=17.0))
    environment_fine: ShadingPass = field(default_factory=lambda: ShadingPass(1.5, 2, 120.0, bilateral_angle=17.0))
    environment_last: ShadingPass = field(default_factory=lambda: ShadingPass(1.5, 2, 60.0, bilateral_angle=17.0))


@dataclass(frozen=True)
class DepthFillingOptions(Options):
    """The filling of gaps in depth maps."""

    edge: Positive = 0.03  # sRGB 0..1; difference of neighbouring pixels that counts as an edge
    edge_smoothness: Positive = 1e-6  # cost of bending across an edge, relative to 1 elsewhere
    data_weight: Positive = 10.0  # weight of the found depths, relative to the bending
    confidence_loss: Positive = 2e-3  # loss of the diffused confidence at each pixel, which falls to 1/e over about
    # twenty pixels
    min_confidence: Share = 0.8  # least confidence of a filled depth


@dataclass(frozen=True)
class SceneStereoOptions(Options):
    """PatchMatch stereo of everything in view, for scenes without masks, and the points on it.

    All other options of the search and of the consistency are those of `expert.stereo`.
    """

    max_pixels: Count = 2_200_000  # most pixels of all photographs together; larger photographs are reduced
    coarser: Annotated[float, Range(0, 1, open=True)] = 0.5  # scale of the smaller photographs on which the search
    # begins and gaps are filled
    nearest: Positive = 0.15  # ball radii; least camera z of the search
    farthest: Positive = 40.0  # ball radii; largest camera z of the search; must exceed nearest
    noise: Positive = 0.003  # sRGB 0..1; replaces the noise of expert.stereo.match.settings, because walls have little
    # contrast
    rounds: WholeNumber = 4  # rounds of the search on the smaller photographs; replaces the rounds of
    # expert.stereo.match.settings
    fine_rounds: WholeNumber = 2  # rounds of the search on the larger photographs, which begins at the depths found
    max_angle: Angle = 75.0  # degrees; views at a larger angle are neither matched nor used for confirmation
    confirming_views: Count = 16  # number of nearest views that may confirm a depth
    spacing: Positive = 1.5  # pixels; size of the cells, in contracted space, in which points are averaged
    min_in_cell: Count = 3  # least number of pixels with a depth in a cell, because most wrong depths lie alone
    spacing_filled: Positive = 0.06  # ball radii; size of the cells, in contracted space, for points at filled depths,
    # because flat regions without contrast need few splats
    same_filled: Positive = 0.02  # largest relative difference of filled depths that count as the same
    min_confirming_filled: WholeNumber = 3  # least number of other views that confirm a filled depth
    filling: DepthFillingOptions = field(default_factory=DepthFillingOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("nearest", "farthest")


@dataclass(frozen=True)
class BackgroundPointOptions(Options):
    """Background points where stereo finds none. Source: iterated conditional modes, Besag 1986."""

    directions: Count = 6000  # number of directions, spread evenly over the sphere; 6000 are 2.6 degrees apart
    nearest: Positive = 1.5  # ball radii from the scene's centre to the nearest level
    farthest: Positive = 40.0  # ball radii from the scene's centre to the farthest level; must exceed nearest
    levels: Annotated[int, Range(2)] = 24  # number of distances, evenly spaced in their inverse
    side: Count = 40  # pixels; longer side of the reduced photographs, enough for plain surfaces
    views: Count = 100  # most photographs to compare
    seen: Count = 3  # least number of photographs that must show a place
    noise: Positive = 0.02  # sRGB 0..1; standard deviation of colours that is mere noise
    most: Positive = 0.15  # sRGB 0..1; upper limit of a standard deviation of colours
    neighbours: Count = 24  # number of neighbouring directions
    step: Positive = 2.0  # difference, in levels, from the neighbours' mean that costs as much as a deviation of noise
    rounds: WholeNumber = 40  # rounds of iterated conditional modes

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("nearest", "farthest")


@dataclass(frozen=True)
class ViewColorOptions(Options):
    """The colours in which views show points."""

    min_cosine: Share = 0.2  # least cosine between normal and view direction, because a pixel at a grazing angle mixes
    # the colours of neighbours
    depth_side: Count = 96  # pixels; side of the depth maps for occlusion, coarse enough that the points leave no gaps


@dataclass(frozen=True)
class PointExposureOptions(Options):
    """The estimation of exposures from points that several photographs show, by reweighted least squares."""

    points: Count = 16000  # most points to use; they also occlude each other, and fewer leave gaps
    behind: NotNegative = 0.05  # scene units; a point that lies farther behind others is hidden
    cells: Positive = 0.5  # side of the occlusion depth map, divided by the square root of the number of points
    min_cosine: Share = 0.2  # least cosine between normal and view direction
    dark: Annotated[int, Range(1, 255)] = 8  # least pixel value that is used, of 255
    clipped: Annotated[int, Range(1, 256)] = 250  # least pixel value that counts as clipped and is not used, of 255;
    # must exceed dark
    max_observations: Count = 4_000_000  # most observations in the fit
    shared: Count = 3  # least number of photographs that show a point
    min_points: Count = 50  # least number of points that each photograph must show
    rounds: Count = 15  # rounds of reweighting
    prior_weight: Positive = 1e-3  # weight of the common exposure, as a share of a photograph's observations
    outlier: Positive = 0.5  # deviations of the residual at which an observation counts half

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("dark", "clipped")


@dataclass(frozen=True)
class BundleAdjustmentOptions(Options):
    """The photometric bundle adjustment of the cameras."""

    max_pixels: Count = 100_000_000  # most pixels of all photographs together; larger photographs are reduced
    cell: Count = 8  # pixels; side of the cells with at most one anchor each
    anchors: Count = 600  # most anchors in a photograph
    max_anchors: Count = 60_000  # most anchors in all photographs
    apart: Positive = 0.25  # ball radii, in contracted space; size of the cells whose anchors form a half
    min_anchors: Count = 300  # least anchors in each half; with fewer, the cameras stay
    least_slope: NotNegative = 0.01  # log light per pixel; least slope of the detail at an anchor
    border: NotNegative = 8.0  # pixels; width of the photograph's border without anchors
    clear: WholeNumber = 2  # pixels around an anchor in which the depth is known and does not jump
    jump: Positive = 0.05  # relative change of the depth within these pixels that counts as a jump
    min_cosine: Share = 0.2  # least cosine between an anchor's normal and the direction to a view that sees it
    same_depth: Positive = 0.015  # largest relative difference of a view's depth from an anchor that the view sees
    near_views: Count = 12  # nearest views with a depth map, whose anchors a view without one sees
    min_views: Count = 4  # least number of views that see an anchor
    most_views: Count = 24  # most views with a depth map to which a photograph's anchors are compared
    blur: Positive = 0.7  # pixels; standard deviation of the blur of the detail
    around: Positive = 3.0  # blurs; standard deviation of the wider blur that is subtracted
    dark: Positive = 0.05  # sRGB 0..1; added to the light before the logarithm
    rounds: WholeNumber = 8  # Gauss-Newton steps with half of the anchors
    last_rounds: WholeNumber = 3  # Gauss-Newton steps with all anchors
    depth_rounds: Count = 3  # steps of the depths alone, before the photographs are compared
    outlier: Positive = 2.0  # deviations at which an observation counts half
    depth_deviation: Positive = 0.01  # relative standard deviation of an anchor's depth
    depth_limit: Positive = 0.01  # largest relative change of an anchor's depth in a step
    hold: Positive = 0.002  # weight of a camera's given pose, as a share of what the photographs tell of it
    min_gain: Share = 0.02  # least share of the deviation between photographs that the adjustment must remove


@dataclass(frozen=True)
class StartConfig(Options):
    """The points on which training begins."""

    resolution: Annotated[int, Range(8)] = 128  # voxels along a side of the visual hull's grid
    carved: Annotated[float, Range(1)] = (
        1.05  # ball radii; half the side of the cube that the visual hull is carved from
    )
    occluding: Positive = (
        4.0  # voxels behind others beyond which a point of the hull is hidden; the hull is accurate to
    )
    # a voxel
    mask_side: Annotated[int, Range(16)] = 400  # pixels; longer side of the reduced masks: two pixels or more a voxel
    min_points: Count = 500  # of stereo, under which the start is a random ball
    ball: Positive = 1.25  # ball radii; outside of this ball no mesh is extracted
    max_spacing: Positive = 8.0  # times the median distance of three neighbours in the ball; points with a larger one
    # are wrong
    max_distance: Positive = 50.0  # ball radii; points with a larger coordinate are wrong
    usual_pixels: Positive = 60_000.0  # area of a masked object's visible surface, in pixels of the photographs, up to
    # which train.surfels.max_start holds; on a larger one, it grows in proportion
    max_detail: Annotated[float, Range(1)] = 8.0  # largest factor by which it grows
    surface: FirstSurfaceOptions = field(default_factory=FirstSurfaceOptions)
    stereo: SceneStereoOptions = field(default_factory=SceneStereoOptions)
    bundle: BundleAdjustmentOptions = field(default_factory=BundleAdjustmentOptions)
    background: BackgroundPointOptions = field(default_factory=BackgroundPointOptions)
    colors: ViewColorOptions = field(default_factory=ViewColorOptions)
    exposures: PointExposureOptions = field(default_factory=PointExposureOptions)

    def detail(self, surface_pixels: float | None) -> float:
        """Return the factor on the 2D branch's number of starting points, from 1 to `max_detail`.

        surface_pixels: the area of the object's visible surface, in pixels of the photographs; None if it is unknown.
        """
        return 1.0 if surface_pixels is None else min(max(1.0, surface_pixels / self.usual_pixels), self.max_detail)
