"""Options of reading a capture (`mgsr.data`): masks, lenses, sharpness, frames of videos, the search for cameras.

Colour differences are out of 255.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.options import Angle, Count, NotNegative, Options, Positive, Range, Share, WholeNumber

Level = Annotated[int, Range(0, 255)]
Pair = Annotated[int, Range(2)]
Factor = Annotated[float, Range(1)]


@dataclass(frozen=True)
class BackdropOptions(Options):
    """The search for a backdrop of one colour in photographs without masks."""

    side: Annotated[int, Range(16)] = 200  # pixels; longer side to which photographs are subsampled by rows and columns
    border: Annotated[float, Range(0, 0.5, open=True)] = 0.03  # width of the border, as a share of a photograph's
    # shorter side
    plain: Level = 16  # difference from the borders' median colour up to which a pixel counts as plain
    min_plain: Share = 0.9  # share of the border pixels that must be plain
    different: Level = 48  # difference from which a pixel shows something other than the backdrop
    min_different: Share = 0.02  # least share of the other pixels that must be different; with fewer, nothing stands
    # before the backdrop
    near: Level = 24  # difference from the backdrop below which a point counts as part of it


@dataclass(frozen=True)
class MaskUseOptions(Options):
    """Whether masks are silhouettes of an object, or mark areas to ignore.

    An agreement is the share of the other views that have a place black too, in excess of chance.
    """

    free_border: Share = 0.75  # share of black border pixels from which masks are silhouettes
    min_black: Share = 0.01  # least median share of black pixels in silhouettes; with less, the object fills the image
    places: Pair = 20  # sample points along each side of the cube in which masks are compared
    reach: Positive = 1.25  # half the side of that cube, in radii of the ball that all images show whole
    ignored: Share = 0.04  # agreement in space below which black is ignored; black rectangles at random places have at
    # most 0.04, and masks of objects that the image cuts off have 0.09 to 0.23
    silhouettes: Share = 0.06  # agreement in space above which masks are silhouettes
    inverted: Share = 0.1  # agreement in space above which inverted silhouettes are looked for; they have 0.11 to 0.19
    same_pixels: Share = 0.6  # agreement in the image above which masks hide a strip of the image or the camera's own
    # stand
    strip_border: Share = 0.6  # share of white border pixels from which such a strip is looked for
    white_border: Share = 0.85  # share of white border pixels from which silhouettes are doubtful
    max_ball: Factor = 2.4  # radii of the ball that the images show whole; the object's ball may be this large
    inverted_views: Share = 0.9  # share of the masks that must look inverted before all are inverted
    inverted_border: Share = 0.95  # least share of white border pixels of an inverted mask
    inverted_black: Share = 0.01  # least share of black pixels of an inverted mask; fewer are holes in a mask of
    # something that fills the image
    inverted_middle: Annotated[float, Range(0, 0.5)] = (
        0.2  # least distance of the black part's centre from the borders,
    )
    # over the image's sides


@dataclass(frozen=True)
class OddMaskOptions(Options):
    """The search for masks that contradict the others."""

    min_views: Pair = 6  # least number of views; with fewer, correct masks also disagree about the object's place
    places: Pair = 32  # sample points along each side of the cube in which masks are compared
    dissent: Share = 0.1  # share of the views whose masks may exclude a point of the object; one view always may
    left_out: Share = 0.5  # share of the object that a mask must leave out to contradict the others
    needed: Share = 0.1  # least share of what a mask leaves out that the other masks need; below it, the mask is right
    max_odd: Share = 0.25  # largest share of contradictory masks; above it, it is unknown which masks are right


@dataclass(frozen=True)
class MaskErrorOptions(Options):
    """The measurement of how far masks contradict each other along their contours."""

    contour_side: Annotated[int, Range(16)] = 400  # pixels; longer side of the silhouettes
    resolution: Annotated[int, Range(16)] = 64  # voxels along a side of the grid that the visual hull is carved from
    half: Factor = 1.05  # half the side of the carved cube, in ball radii
    views: Count = 24  # most views whose contours are looked at; all views carve the hull
    pixels: Count = 50  # most pixels of a contour that are looked at
    steps: Count = 25  # points of a ray near the hull that are looked at
    exact: Positive = 0.3  # pixels; largest error of exact masks; more means inexact masks
    far: Positive = 3.0  # pixels; distance from the hull at which a contour shows that a mask misses something
    far_errors: Positive = 5.0  # that distance in multiples of the median error; the larger distance counts
    least_cut: Count = 3  # least number of such pixels that an incomplete mask excludes
    concentrated: Positive = 6.0  # that number in multiples of the mean over all masks; the larger number counts
    min_views: Pair = 6  # least number of views with complete masks
    max_incomplete: Share = 0.15  # largest share of incomplete masks; above it, it is unknown which masks are right


@dataclass(frozen=True)
class NormalisationOptions(Options):
    """The search for the ball that holds the object."""

    resolution: Annotated[int, Range(8)] = 64  # voxels along a side of the grid that the visual hull is carved from
    contour_side: Annotated[int, Range(16)] = 200  # pixels; longer side of the silhouettes
    margin: Factor = 1.05  # half the side of the carved cube, and the radius of a ball of points, over the object's
    min_points: Count = 50  # points of the capture; with fewer, they do not place the ball
    parallel: Share = 0.02  # mean squared sine between viewing rays and their main direction; below it, the cameras
    # look in one direction and have no common focus
    ahead: Share = 0.8  # least share of the cameras that have their common focus in front of them
    enclosed: Share = 0.99  # share of the points near the focus that the ball holds
    enclosed_one_sided: Share = 0.9  # share of all points that the ball holds if the cameras look in one direction
    least_radius: Share = 0.25  # least radius of the ball around points, over that of the ball in view
    least_in_view: Share = 0.1  # least radius of the ball in view of a camera, over its distance
    ahead_one_sided: Positive = 4.0  # distance of the scene ahead of cameras that look in one direction, over their
    # largest distance from their mean, where no points tell it


@dataclass(frozen=True)
class UndistortionOptions(Options):
    """The pinhole image that an undistorted photograph fills."""

    half_angle: Annotated[float, Range(10, 80)] = 60.0  # degrees from the optical axis to which wide lenses are
    # cropped; 60 hold 90% of an action camera's photograph, 70 hold 99% in an image with almost twice the pixels
    rectangle: Share = 0.97  # share of the valid pixels that the largest valid rectangle must hold to be kept in place
    # of a mask
    max_growth: Factor = 2.0  # largest growth of the image along each side; a lens beyond it counts as a wide fisheye
    sketch: Annotated[int, Range(16)] = 128  # columns and rows of the coarse grid that finds the valid part of the
    # image


@dataclass(frozen=True)
class SharpnessOptions(Options):
    """The search for blurred photographs.

    Sharpness is counted in powers of two. Sharp photographs lack at most 0.43 against their neighbours; photographs
    moved by 5 pixels lack 0.5 to 1.2.
    """

    side: Annotated[int, Range(16)] = 800  # pixels; longer side at which sharpness is measured
    min_side: Count = 48  # pixels; images whose shorter side is smaller are too small to judge
    sigma: Positive = 1.5  # pixels; standard deviation of the Gaussian that blurs a photograph for comparison with
    # itself
    max_loss: NotNegative = 0.55  # powers of two of sharpness that a photograph may lack against its neighbours
    nearest: WholeNumber = 6  # number of neighbours by the cameras' places
    adjacent: WholeNumber = 8  # number of neighbours by name, before and after each photograph
    same_side: Angle = 75.0  # degrees between the directions of two cameras; beyond it they show different sides of an
    # object, of which one may be plainer, so neighbours by name do not count


@dataclass(frozen=True)
class BrightnessOptions(Options):
    """The comparison of a photograph's mean light with that of its neighbours."""

    side: Annotated[int, Range(16)] = 256  # pixels; longer side to which photographs are subsampled
    neighbours: Count = 4  # number of neighbours of a photograph, from the nearest directions


@dataclass(frozen=True)
class UpOptions(Options):
    """The search for the direction that points up, by the axes of the cameras."""

    near_axis: Annotated[float, Range(0, 45)] = 20.0  # degrees within which the direction snaps to an axis
    min_mean: Share = 0.1  # least length of the mean of the cameras' up vectors; a shorter mean is unreliable
    lying: Share = 0.9  # length of the mean of the cameras' right vectors above which all cameras lie on their side
    level: Share = 0.14  # largest root mean square of the sines of the cameras' sideways tilts at which they count as
    # level; 0.14 is 8 degrees
    around: Share = 0.1  # mean square of the cameras' right vectors across their main direction, above which the
    # cameras look from all around


@dataclass(frozen=True)
class ViewCountOptions(Options):
    """The warning of too few photographs."""

    min_views: Count = 8  # least number of training photographs; with fewer, the surface is rough at best
    max_angle: Angle = 35.0  # degrees; largest angle between two views at which a surface still looks alike in both


@dataclass(frozen=True)
class FrameOptions(Options):
    """The choice of frames of a video. Motion is counted in diagonals of the image."""

    motion_side: Annotated[int, Range(32)] = 320  # pixels; longer side at which motion is measured
    sharpness_side: Annotated[int, Range(32)] = 960  # pixels; longer side at which sharpness is measured
    sigma: Positive = 1.5  # pixels; detail finer than this is what blur takes away
    features: Count = 200  # features that are followed from frame to frame
    min_left: Share = 0.6  # share of the features below which they are detected again
    min_features: Count = 8  # least features that measure a motion
    stretch: Positive = 0.01  # motion after which features are detected again
    quantile: Share = 0.75  # quantile of the features' motions that counts; many may lie on a still background
    step: Positive = 0.04  # motion between two chosen frames
    min_step: Positive = 0.01  # least motion between two chosen frames, in videos with little motion
    min_frames: Count = 40  # frames below which the steps get smaller
    apart: Share = 0.4  # share of a step; least motion between two chosen frames
    quality: Annotated[int, Range(1, 100)] = 97  # of JPEG
    knee: Annotated[float, Range(0, 0.99)] = 0.8  # of diffuse white; brighter light of HDR videos is compressed


@dataclass(frozen=True)
class ImagePairOptions(Options):
    """The choice of the pairs of photographs whose features are compared."""

    exhaustive: Count = 150  # photographs up to which all pairs are compared
    exhaustive_frames: Count = 50  # frames of videos up to which all pairs are compared
    similar: WholeNumber = 30  # photographs of the most similar look that each photograph is compared with
    similar_frames: WholeNumber = 10  # frames of the most similar look that each frame of a video is compared with
    following: Count = 10  # following photographs, by name, that each photograph is compared with
    words: Pair = 1024  # words of the vocabulary that measures how similar photographs look
    sample: Count = 100_000  # features from which the vocabulary is learned
    ordered: Share = 0.8  # share of the photographs whose number follows that of the one before, from which names
    # count as ordered


@dataclass(frozen=True)
class ZoomCheckOptions(Options):
    """The warning of photographs that do not fit the lens that they share with others."""

    max_change: NotNegative = 0.03  # relative difference of a photograph's own focal length; fixed lenses stay within
    # 0.02
    min_points: Count = 30  # least points of a photograph whose focal length is known
    min_share: Share = 0.05  # least share of such photographs for a warning; blur or motion explain fewer
    min_photographs: Count = 2  # least number of such photographs for a warning


@dataclass(frozen=True)
class CameraSearchOptions(Options):
    """The search for cameras by structure from motion with COLMAP."""

    feature_side: Annotated[int, Range(64)] = 2400  # pixels; longer side to which photographs are reduced for the
    # search for features
    peak: Positive = 0.0033  # least contrast of a feature; it is half of COLMAP's default, so that plain objects have
    # features too
    focal_guess: Positive = 1.2  # assumed focal length of an unknown lens, in longer sides of the image
    max_models: Count = 10  # largest number of separate models; the largest model is taken
    pairs: ImagePairOptions = field(default_factory=ImagePairOptions)
    zoom: ZoomCheckOptions = field(default_factory=ZoomCheckOptions)


@dataclass(frozen=True)
class DataOptions(Options):
    """The reading of a capture."""

    mask_dissent: Share = 0.06  # share of a found object's masks that may exclude a point of the object
    backdrop: BackdropOptions = field(default_factory=BackdropOptions)
    mask_use: MaskUseOptions = field(default_factory=MaskUseOptions)
    odd_masks: OddMaskOptions = field(default_factory=OddMaskOptions)
    mask_error: MaskErrorOptions = field(default_factory=MaskErrorOptions)
    normalisation: NormalisationOptions = field(default_factory=NormalisationOptions)
    undistortion: UndistortionOptions = field(default_factory=UndistortionOptions)
    sharpness: SharpnessOptions = field(default_factory=SharpnessOptions)
    brightness: BrightnessOptions = field(default_factory=BrightnessOptions)
    up: UpOptions = field(default_factory=UpOptions)
    view_count: ViewCountOptions = field(default_factory=ViewCountOptions)
    frames: FrameOptions = field(default_factory=FrameOptions)
    cameras: CameraSearchOptions = field(default_factory=CameraSearchOptions)
