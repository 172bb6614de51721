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
    concavities need many rounds. An environment map hardly constrains a hull's steps, which fairing removes between the
    rounds. It constrains the small shape better once photometric refinement has corrected the large shape.
    """

    mirror_share: NotNegative = 0.9  # the surface is a mirror if the hull's residual under an environment map is at
    # most this share of stereo's
    disbelieved: Positive = 0.3  # octaves by which stereo's residual may exceed the hull's before its depths lose all
    # weight
    coarse_scale: Annotated[float, Range(0, 1, open=True)] = 0.5  # of the photographs' sides for the coarser stereo
    photometric_reach: Positive = 5.0  # pixels over which the photometric refinement spreads a displacement
    flash_coarse: ShadingPass = field(default_factory=lambda: ShadingPass(edge=2.0, rounds=6, reach=160.0))
    flash_fine: ShadingPass = field(default_factory=lambda: ShadingPass(edge=1.5, rounds=3, reach=60.0))
    environment_repeats: Count = 3  # times that the pass environment_coarse is run
    environment_coarse: ShadingPass = field(default_factory=lambda: ShadingPass(3.0, 2, 240.0, fairing=17.0))
    environment_medium: ShadingPass = field(default_factory=lambda: ShadingPass(2.0, 2, 240.0, fairing=17.0))
    environment_fine: ShadingPass = field(default_factory=lambda: ShadingPass(1.5, 2, 120.0, fairing=17.0))
    environment_last: ShadingPass = field(default_factory=lambda: ShadingPass(1.5, 2, 60.0, fairing=17.0))


@dataclass(frozen=True)
class DepthFillingOptions(Options):
    """The filling of gaps in depth maps."""

    edge: Positive = 0.03  # sRGB 0..1; difference of neighbouring pixels that counts as an edge
    edge_smoothness: Positive = 1e-6  # cost of bending across an edge, relative to 1 elsewhere
    data_weight: Positive = 10.0  # of the found depths, relative to the bending
    confidence_loss: Positive = 2e-3  # leak of the diffused confidence at each pixel: it falls to 1/e over about twenty
    # pixels
    min_confidence: Share = 0.8  # least confidence of a filled depth


@dataclass(frozen=True)
class PlaneSweepOptions(Options):
    """Plane-sweep stereo of scenes without masks. Source: Collins 1996."""

    side: Annotated[int, Range(16)] = 128  # pixels; longer side of the reduced images, enough for starting points
    planes: Annotated[int, Range(4)] = 64  # through the ball, spaced evenly in inverse depth
    planes_behind: Count = 32  # from there to infinity
    reach: Positive = 1.1  # ball radii; extent of the ball's planes on both sides of the centre
    max_distance: Positive = 40.0  # ball radii from the centre; farther points are too uncertain
    neighbours: Annotated[int, Range(2)] = 4  # views to compare
    best_angle: Angle = 15.0  # degrees to the best neighbour, as seen from the scene's centre
    max_angle: Angle = 45.0  # degrees; views at a larger angle are no neighbours
    half_window: WholeNumber = 2  # pixels of a window on each side of its middle
    noise: Positive = 0.01  # grey 0..1; standard deviation of image noise; lowers the correlation of windows with less
    # contrast
    similar: Positive = 0.06  # sRGB 0..1; width of similar colours
    own_contrast: NotNegative = 0.012  # sRGB 0..1; least contrast among similar colours
    agreement: Share = 0.6  # least correlation of an accepted depth
    lead: NotNegative = 0.03  # least lead in correlation over all planes farther away than beside
    beside: Count = 4  # planes
    confirmed: WholeNumber = 2  # least number of other views with the same depth
    confirmed_filled: WholeNumber = 3  # the same number for filled depths, which depend on each other
    tolerance: Positive = 0.02  # relative difference of depths that count as the same
    spacing: Positive = 0.02  # ball radii, contracted outside the ball; cell size for thinning points
    spacing_filled: Positive = 0.06  # the same for filled depths; flat regions without contrast need few splats
    crowd: Count = 20  # nearest neighbours whose mean distance tells outliers
    lonely: NotNegative = 1.5  # deviations of that distance above which a point is an outlier
    filling: DepthFillingOptions = field(default_factory=DepthFillingOptions)

    @property
    def window(self) -> int:
        """Return the window's side in pixels."""
        return 2 * self.half_window + 1


@dataclass(frozen=True)
class BackgroundPointOptions(Options):
    """Background points where stereo finds none. Source: iterated conditional modes, Besag 1986."""

    directions: Count = 6000  # spread evenly over the sphere; 6000 are 2.6 degrees apart
    nearest: Positive = 1.5  # ball radii from the scene's centre to the nearest level
    farthest: Positive = 40.0  # ball radii from the scene's centre to the farthest level; must exceed nearest
    levels: Annotated[int, Range(2)] = 24  # distances, even in their inverse
    side: Count = 40  # pixels; longer side of the reduced photographs, enough for plain surfaces
    views: Count = 100  # most photographs to compare
    seen: Count = 3  # least number of photographs that must show a place
    noise: Positive = 0.02  # sRGB 0..1; colour deviation of noise
    most: Positive = 0.15  # sRGB 0..1; limit of all deviations
    neighbours: Count = 24  # neighbouring directions
    step: Positive = 2.0  # levels off the neighbours' mean that cost as much as a deviation of noise
    rounds: WholeNumber = 40  # of iterated conditional modes

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("nearest", "farthest")


@dataclass(frozen=True)
class ViewColorOptions(Options):
    """The colours in which views show points."""

    min_cosine: Share = 0.2  # least cosine between normal and view direction: at a grazing angle, a pixel mixes the
    # colours of neighbours
    depth_side: Count = 96  # pixels; side of the depth maps for occlusion, coarse enough that the points leave no gaps


@dataclass(frozen=True)
class PointExposureOptions(Options):
    """The estimation of exposures from points that several photographs show, by reweighted least squares."""

    points: Count = 16000  # most points to use; they also occlude each other, and fewer leave gaps
    behind: NotNegative = 0.05  # scene units behind others beyond which a point is hidden
    cells: Positive = 0.5  # side of the occlusion depth map, times the square root of the number of points
    min_cosine: Share = 0.2  # least cosine between normal and view direction
    dark: Annotated[int, Range(1, 255)] = 8  # of 255; darker pixels are not used
    clipped: Annotated[int, Range(1, 256)] = 250  # of 255; pixels from this value on are not used; must exceed dark
    max_observations: Count = 4_000_000  # in the fit
    shared: Count = 3  # least number of photographs that show a point
    min_points: Count = 50  # in a photograph
    rounds: Count = 15  # of reweighting
    prior_weight: Positive = 1e-3  # of the common exposure, as a share of a photograph's observations
    outlier: Positive = 0.5  # deviations of the residual at which an observation counts half

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("dark", "clipped")


@dataclass(frozen=True)
class StartConfig(Options):
    """The points on which training begins."""

    resolution: Annotated[int, Range(8)] = 128  # voxels along a side of the visual hull's grid
    mask_side: Annotated[int, Range(16)] = 400  # pixels; longer side of the reduced masks: two pixels or more a voxel
    min_points: Count = 500  # of stereo, under which the start is a random ball
    ball: Positive = 1.25  # ball radii; outside of this ball no mesh is extracted
    outside: Share = 0.25  # largest share of an unmasked capture's points outside of that ball
    background_share: Share = 0.25  # largest share of all points that are background points
    max_spacing: Positive = 8.0  # times the median distance of three neighbours in the ball; points with a larger one
    # are wrong
    max_distance: Positive = 50.0  # ball radii; points with a larger coordinate are wrong
    surface: FirstSurfaceOptions = field(default_factory=FirstSurfaceOptions)
    sweep: PlaneSweepOptions = field(default_factory=PlaneSweepOptions)
    background: BackgroundPointOptions = field(default_factory=BackgroundPointOptions)
    colors: ViewColorOptions = field(default_factory=ViewColorOptions)
    exposures: PointExposureOptions = field(default_factory=PointExposureOptions)
