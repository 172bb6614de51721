"""Options of the algorithms on meshes (`mgsr.geometry`)."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.options import Count, NotNegative, Options, Positive, Share, WholeNumber

MAX_FACES = 150_000  # of a mesh that an optimisation runs on


@dataclass(frozen=True)
class BilateralOptions(Options):
    """The bilateral filter of a mesh's normals. Source: Zheng and others 2011."""

    rounds: WholeNumber = 4  # rounds of filtering the normals; more rounds flatten real detail
    steps: WholeNumber = 10  # steps of moving the vertices to match the normals
    folded: Share = 0.7  # cosine between a face's normal and its filtered normal; with a lower one, the face counts as
    # folded


@dataclass(frozen=True)
class ContourSearchOptions(Options):
    """The search for a mesh's contour beside a mask's; pixels are those of the masks."""

    search: Positive = 3.0  # pixels on either side of a mask's contour in which the mesh's contour is searched for
    step: Positive = 0.25  # pixels between two rays of the search
    finer: Count = 8  # number of rays that refine the contour within a step; fewer pull surfaces inwards by 0.04 pixels
    facing: Share = 0.5  # least cosine between the surface normal and the contour's outward direction


@dataclass(frozen=True)
class ContourOptions(Options):
    """The registration of a mesh to silhouette contours; pixels are those of the masks."""

    coarse_edge: Positive = 1.0  # pixels; edge length of the coarse mesh that carries the smooth correction
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    prior_weight: Positive = 0.02  # of a displacement of 0 where no contour touches; a vertex follows its neighbours
    rounds: WholeNumber = 2  # of finding the mesh's contours and moving its vertices
    inexact_smoothing: Positive = 3.0  # multiple of `silhouette_smoothing` for inexact masks, whose contours err by
    # about a third of a pixel or more
    inexact_prior_weight: Positive = 0.1  # prior_weight for inexact masks; keeps a correction near its contours
    search: ContourSearchOptions = field(default_factory=ContourSearchOptions)


@dataclass(frozen=True)
class LowFrequencyOptions(Options):
    """The smoothing of low-frequency waves; its unit is a pixel of the photographs on the surface.

    Source: local regression, Cleveland 1979.
    """

    edge: Positive = 1.0  # units; edge length of the coarse mesh that is smoothed
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    reach: Positive = 2.5  # units; standard deviation of the Gaussian that weighs a vertex's neighbours
    far: Positive = 2.0  # largest distance of a neighbour that counts, in multiples of reach
    rounds: Count = 3  # rounds of filtering the normals
    regularization: Positive = 0.15  # strength, in units of reach squared, that pulls a fit's slopes to 0 where
    # neighbours are few
    kept: NotNegative = 2.0  # units; wavelengths above 2 pi times this keep their positions, and shorter ones follow
    # the normals


@dataclass(frozen=True)
class ChartOptions(Options):
    """The cut of a surface into flat charts."""

    smoothing: WholeNumber = 30  # rounds of averaging the face normals, so that charts have smooth borders
    min_cosine: Share = 0.25  # least cosine of a face's tilt in its chart; the tilt stretches the face's texels by the
    # inverse
    kept: Share = 0.6  # factor on min_cosine; faces that tilt beyond the product leave a finished chart
    small: Share = 1e-3  # share of the surface's area; smaller charts join a neighbour that faces their way
    rounds: WholeNumber = 6  # rounds of joining small charts and of removing faces that overlap in their chart or tilt
    # too far
    inset: Share = 0.9  # share of the way from a face's centre to its corners at which overlap is tested


@dataclass(frozen=True)
class GeometryConfig(Options):
    """Algorithms on meshes."""

    bilateral: BilateralOptions = field(default_factory=BilateralOptions)
    contours: ContourOptions = field(default_factory=ContourOptions)
    low_frequency: LowFrequencyOptions = field(default_factory=LowFrequencyOptions)
