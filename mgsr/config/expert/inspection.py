"""Options of the check before training (`mgsr.inspection`).

Pixels of matches are those of the reduced images in which features are found.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.options import Angle, Count, NotNegative, Options, Positive, Range, Share, WholeNumber


@dataclass(frozen=True)
class FeatureOptions(Options):
    """The local features of photographs, and which photographs look alike."""

    side: Annotated[int, Range(16)] = 512  # pixels; longer side of the reduced image in which features are found
    count: Annotated[int, Range(2)] = 800  # most features of a photograph, the strongest first
    edge: WholeNumber = 4  # pixels from a silhouette or an invalid pixel; nearer features are dropped, because they
    # depend on the background
    words: Annotated[int, Range(2)] = 32  # words of the visual vocabulary that describes whole photographs
    sample: Count = 6000  # features from which that vocabulary is made
    ratio: Share = 0.8  # largest ratio of the distances of the best and the second best match (Lowe 2004)
    around: Positive = 1.5  # pixels; standard deviation of the Gaussian window in which a feature's light is measured
    clipped: Annotated[int, Range(0, 255)] = 250  # least pixel value that may be clipped, so that its light counts as
    # unknown
    black: Annotated[int, Range(0, 255)] = 3  # largest pixel value that is too dark to measure its light
    lost: Share = 0.05  # share of clipped or black pixels in the window above which a feature's light is unknown


@dataclass(frozen=True)
class PairOptions(Options):
    """The comparison of pairs of photographs with their cameras."""

    nearest: WholeNumber = 4  # photographs with the nearest cameras that each photograph is compared with
    alike: WholeNumber = 5  # photographs of the most similar look that each photograph is compared with
    inlier: Positive = 1.5  # pixels from the epipolar line of the pair's own geometry
    min_matches: Count = 24  # least matches of one geometry in a pair that counts as evidence; chance gives about 10
    explained: Share = 0.6  # share of the matches on the cameras' epipolar lines that needs no other explanation
    off: Positive = 4.0  # pixels from the cameras' epipolar line beyond which a match contradicts them


@dataclass(frozen=True)
class VerdictOptions(Options):
    """The verdicts on pairs. A limit is the larger of its pixels and its multiple of the capture's usual residual.

    Phones report less accurate cameras than structure from motion, and these are not contradictory.
    """

    agrees: Positive = 1.5  # pixels; median residual below which a pair agrees with its cameras
    agrees_usual: NotNegative = 3.0  # multiple of the usual residual below which a pair agrees with its cameras
    contradicts: Positive = 5.0  # pixels; median residual above which a pair contradicts its cameras
    contradicts_usual: NotNegative = 8.0  # multiple of the usual residual above which a pair contradicts its cameras
    meets: Positive = 2.0  # pixels by which the rays of three photographs may miss each other
    meets_usual: NotNegative = 4.0  # multiple of the usual residual by which such rays may miss each other
    max_usual: NotNegative = 4.0  # pixels; largest usual residual that counts
    min_shared: Count = 8  # least points that three photographs share to count as evidence
    tolerated: WholeNumber = 2  # contradicting pairs of an unproven photograph that cast no doubt on its other pairs


@dataclass(frozen=True)
class PoseCheckOptions(Options):
    """The search for poses that contradict the photographs."""

    cluster: Annotated[int, Range(2)] = 3  # least number of photographs of a cluster that sees its own copy of the
    # structure
    min_contradictions: Count = 2  # least number of pairs that contradict a photograph or a cluster with wrong poses
    accused: Share = 0.5  # share of a cluster that must be in contradictory pairs; a part that repeats elsewhere
    # involves few photographs
    majority: Share = 0.5  # least share of the decided photographs in the largest group; with less, no photograph is
    # called contradictory
    many: Share = 0.1  # share of the photographs with contradictory poses above which the finding is an error
    less_exact: Positive = 0.7  # pixels; residual of a photograph's better pairs above which it fits less exactly
    less_exact_usual: NotNegative = 4.0  # multiple of the usual residual above which a photograph fits less exactly
    less_exact_pairs: Annotated[int, Range(2)] = 3  # least pairs of a photograph that is judged
    inaccurate: NotNegative = 1.5  # pixels; usual residual above which poses are called inaccurate
    repeated: NotNegative = 0.15  # largest ratio of contradicting to agreeing pairs inside one group
    connected: Share = 0.8  # share of the photographs with many features that one group should have
    moving: Share = 0.15  # share of the matches that follow another motion, in the mean of the pairs


@dataclass(frozen=True)
class CoverageOptions(Options):
    """The check of the cameras' places around the object."""

    seen: Angle = 50.0  # degrees between a side of the object and a camera; beyond it, the camera sees the side at a
    # grazing angle at best
    underside: Share = 0.35  # sine of the angle below the horizon beyond which a side belongs to the underside
    min_gap: Share = 0.03  # share of the sphere, without the underside
    directions: Count = 1500  # directions in which the object's sides are tested
    max_places: Count = 6  # most places for further photographs that a finding names
    error_angle: Angle = 4.0  # degrees between the two most distant cameras below which the finding is an error
    small_angle: Angle = 12.0  # degrees between the two most distant cameras below which the finding is a warning


@dataclass(frozen=True)
class PhotoCheckOptions(Options):
    """The check of single photographs, their masks and their lenses."""

    jumps: NotNegative = 0.05  # spread of log light above chance
    shared_places: Annotated[int, Range(4)] = 16  # least matches of a photograph whose light is known
    min_known: Share = 0.5  # share of the photographs whose light must be known
    common: Share = 0.6  # correlation of the light of both halves of the photographs; gloss changes one half alone
    outlier: Annotated[float, Range(1)] = 2.0  # factor against the neighbours' light beyond which highlights or shadows
    # are lost
    small_share: Share = 0.2  # diameter of a small object, as a share of the image's shorter side
    small_pixels: NotNegative = 100.0  # pixels; diameter of a small object
    cut_off: Share = 0.5  # share of the photographs that cut the object off, above which a finding says so
    left_out: Share = 0.3  # share of the object in the other masks that a mask may leave out; few views give up
    # to 0.24
    contour_side: Annotated[int, Range(16)] = 200  # pixels at which masks are compared
    focal: NotNegative = 0.1  # relative difference of focal lengths above which lenses differ
    wide: Angle = 100.0  # degrees across the image above which a lens counts as wide
    small_side: NotNegative = 480.0  # pixels; longer side below which images count as small


@dataclass(frozen=True)
class InspectionConfig(Options):
    """The check before training."""

    photographs: Annotated[int, Range(2)] = 300  # most photographs whose features are compared, spread evenly over all
    track: Annotated[int, Range(2)] = 3  # least number of photographs that must show a point
    min_points: Count = 50  # least number of points whose median shows where the object is
    features: FeatureOptions = field(default_factory=FeatureOptions)
    pairs: PairOptions = field(default_factory=PairOptions)
    verdicts: VerdictOptions = field(default_factory=VerdictOptions)
    poses: PoseCheckOptions = field(default_factory=PoseCheckOptions)
    coverage: CoverageOptions = field(default_factory=CoverageOptions)
    photos: PhotoCheckOptions = field(default_factory=PhotoCheckOptions)
