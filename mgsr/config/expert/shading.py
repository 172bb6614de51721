"""Options of the photographs' shading: light, normals and photometric refinement (`mgsr.shading`).

Pixels are those of the photographs on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from mgsr.config.expert.geometry import MAX_FACES, BilateralOptions, ContourSearchOptions
from mgsr.config.options import Angle, Count, NotNegative, Options, Positive, Range, Share, WholeNumber


@dataclass(frozen=True)
class ObservationOptions(Options):
    """The observations of a surface's points in the photographs."""

    min_cosine: Share = 0.25  # least cosine between normal and view direction
    min_alpha: Share = 0.97  # least alpha of a pixel; pixels with less mix object and background
    clipped: Share = 0.98  # largest value of a pixel's brightest channel; brighter pixels count as clipped
    count: Count = 24  # most observations of a point, the most frontal ones


@dataclass(frozen=True)
class OcclusionOptions(Options):
    """Ambient occlusion and one-bounce interreflection."""

    edge: Positive = 4.0  # pixels; edge length of the mesh on which both are computed
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    rays: Count = 64  # rays of each vertex
    min_cosine: Share = 0.05  # least cosine between normal and view direction at which a photograph's brightness counts


@dataclass(frozen=True)
class FlashFitOptions(Options):
    """The calibration of a flash, by variable projection. Source: Golub and Pereyra 1973."""

    points: Count = 3000  # approximate number of points in the fit
    steps: Count = 40  # most Gauss-Newton steps
    step_tolerance: NotNegative = 3e-4  # move of the lamp, as a share of the distance to the surface, below which the
    # fit ends
    rounds: Count = 4  # rounds of reweighting in a step
    damping: NotNegative = 1e-3  # damping of Levenberg and Marquardt, for weakly constrained parameters
    max_offset: NotNegative = 0.25  # largest offset of the lamp from the lens, as a share of the distance to the
    # surface


@dataclass(frozen=True)
class IrradianceOptions(Options):
    """The irradiance of a surface by a flash, and its images."""

    edge: Positive = 1.5  # pixels; edge length of the mesh that carries the light
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    brightest: Share = 0.995  # quantile of the irradiance that counts as the brightest light
    rays: Count = 512  # least number of rays along an image's longer side; small images take several rays for a pixel
    dimmest: Annotated[float, Range(0, 1, open=True)] = 0.02  # least irradiance at which a photograph shows a colour


@dataclass(frozen=True)
class FlashOptions(Options):
    """Photometric stereo under a flash. Source: Woodham 1980."""

    min_observations: Count = 5  # photographs that see a point; with fewer, its confidence is 0
    prior_weight: NotNegative = 0.005  # weight of the surface's own normal, relative to the photographs
    rounds: Count = 5  # rounds of iteratively reweighted least squares
    above: Positive = 0.5  # deviations at which an observation that is too bright counts half
    below: Positive = 1.5  # deviations at which an observation that is too dark counts half
    half_confidence: Positive = 0.03  # radians; standard deviation of a normal at which the confidence is 0.5
    footprint_edge: NotNegative = 1.25  # pixels; edge length below which observations are corrected for the pixels'
    # footprints
    footprint_rays: Count = 2  # rays along a pixel's side in that correction
    fit: FlashFitOptions = field(default_factory=FlashFitOptions)
    occlusion: OcclusionOptions = field(default_factory=OcclusionOptions)
    irradiance: IrradianceOptions = field(default_factory=IrradianceOptions)


@dataclass(frozen=True)
class EnvironmentFitOptions(Options):
    """The fit of the environment map that a surface mirrors, by robust least squares."""

    height: Annotated[int, Range(2)] = 32  # cells of the polar angle; the azimuth has twice as many
    points: Count = 6000  # most points in the fit
    min_observations: Annotated[int, Range(2)] = 3  # photographs that see a point of the fit
    smoothness: NotNegative = 0.002  # weight of the squared differences of neighbouring cells, relative to the
    # observations
    rounds: Count = 3  # rounds of iteratively reweighted least squares
    outlier: Positive = 3.0  # deviations at which an observation counts half


@dataclass(frozen=True)
class EnvironmentNormalOptions(Options):
    """The search for the normals that explain the mirrored environment map."""

    max_tilt: Annotated[float, Range(0, 80, open=True)] = 16.0  # degrees; largest tilt on each of two axes
    step: Annotated[float, Range(0, 80, open=True)] = 4.0  # degrees between two tilts
    fine_step: Annotated[float, Range(0, 80, open=True)] = 1.0  # degrees between two tilts around the best one
    cells: Annotated[int, Range(2)] = 64  # along a side of the map's lookup table; 64 resolve directions to 2 degrees
    min_observations: Count = 5  # photographs that see a point; with fewer, its confidence is 0
    outlier: Positive = 3.0  # deviations at which an observation counts half
    pooled: NotNegative = 2.5  # pixels over which the costs of neighbours are pooled
    tilt_cost: NotNegative = 0.08  # cost of a tilt by 10 degrees, relative to the observations' mean cost
    convex: NotNegative = 0.12  # radians per pixel; convex edges that bend more are kept, because pixels show too
    # little of each side
    half_confidence: Positive = 4.0  # degrees; standard deviation of a normal at which the confidence is 0.5


@dataclass(frozen=True)
class EnvironmentResidualOptions(Options):
    """The photometric residual of a surface under a mirrored environment map."""

    averaged: NotNegative = 6.0  # pixels over which residuals are averaged
    min_observations: Count = 3  # least number of observations of a point that counts


@dataclass(frozen=True)
class EnvironmentOptions(Options):
    """Static light that the surface mirrors."""

    edge: Positive = 2.0  # pixels; edge length of the mesh for the fit of the map
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    min_cosine: Share = 0.5  # least cosine of the tilt; at grazing angles, reflection is stronger than one map can
    # model (Fresnel)
    fit: EnvironmentFitOptions = field(default_factory=EnvironmentFitOptions)
    normals: EnvironmentNormalOptions = field(default_factory=EnvironmentNormalOptions)
    residual: EnvironmentResidualOptions = field(default_factory=EnvironmentResidualOptions)


@dataclass(frozen=True)
class LightOptions(Options):
    """The choice of the light model, and both models."""

    edge: Positive = 2.0  # pixels; edge length of the mesh on which the light models are compared
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    max_environment_ratio: NotNegative = 0.85  # largest residual ratio of a map on an approximate surface
    flash: FlashOptions = field(default_factory=FlashOptions)
    environment: EnvironmentOptions = field(default_factory=EnvironmentOptions)


@dataclass(frozen=True)
class ShadingOptions(Options):
    """The integration of target normals to a surface. Source: Nehab and others 2005."""

    contour_weight: NotNegative = 10.0  # weight of a contour's displacement at a vertex that it touches
    prior_weight: Positive = 0.05  # weight of a displacement of 0 at every vertex
    max_faces: Count = MAX_FACES  # most faces of the mesh that is bent
    contour_smoothing: NotNegative = 1.5  # pixels over which the contours' displacements are smoothed
    bilateral: BilateralOptions = field(default_factory=BilateralOptions)
    contours: ContourSearchOptions = field(default_factory=ContourSearchOptions)


@dataclass(frozen=True)
class ShadingPass(Options):
    """Rounds of estimating target normals and fitting the surface to them."""

    edge: Positive  # pixels; the mesh's edge length
    rounds: WholeNumber  # of estimating normals and fitting the surface
    reach: Positive  # pixels; wavelength above which shape stays unless contours move it
    bilateral_angle: Angle = 0.0  # degrees of the bilateral filter before and after the rounds; 0 is none


@dataclass(frozen=True)
class DetailOptions(Options):
    """The fine detail of a surface in photographs, and the mix of channels that locates it best."""

    blur: NotNegative = 1.0  # pixels; standard deviation of the Gaussian that removes image noise
    coarse: Positive = 3.0  # pixels; standard deviation of the wider Gaussian that is subtracted, because coarser
    # variation is shading
    min_cosine: Share = 0.3  # least cosine between normal and view direction
    min_observations: Count = 4  # least number of photographs that must see a vertex
    max_deviations: Positive = 3.0  # deviations of the residual; larger residuals do not count in the choice of the mix
    min_gain: NotNegative = 1.5  # least factor by which another mix must be more informative than grey


@dataclass(frozen=True)
class PhotometricOptions(Options):
    """The photometric refinement. Source: Lucas and Kanade 1981; Vu and others 2012."""

    edge: Positive = 1.5  # pixels; edge length of the mesh at whose vertices the photographs are sampled
    coarse_edge: Positive = 3.0  # pixels; edge length of the mesh that carries the smooth displacements
    max_faces: Count = MAX_FACES  # most faces of either mesh
    rounds: WholeNumber = 6  # rounds of sampling the photographs and moving the vertices
    accurate_rounds: WholeNumber = 2  # rounds on an accurate surface, such as the trained one
    mirrored_rounds: WholeNumber = 4  # rounds, of one step each, where the surface mirrors a known environment map:
    # reflections move it inwards, a little in each step
    steps: Count = 3  # steps to a round, all from its samples and their slopes
    agreement_reach: Positive = 6.0  # pixels over which the agreement of the two halves of the photographs is averaged
    min_in_half: Count = 2  # least number of photographs of a half that must show a vertex
    limit: NotNegative = 1.0  # pixels; largest move of a vertex in a round
    noise_reach: NotNegative = 3.0  # pixels over which the residual variance is averaged
    outlier: Positive = 3.0  # deviations at which an observation counts half
    mix_views: Count = 16  # most photographs for the choice of the channel mix
    mirrored: Positive = 0.1  # mirrored detail, in multiples of the noise, at which an observation counts half
    precision: Positive = 0.3  # pixels; standard deviation of a displacement with weight 1 in the thin plate
    contour_precision: Positive = 0.1  # pixels; standard deviation of a mask's contour
    inexact_contour_precision: Positive = 0.3  # pixels; standard deviation of an inexact mask's contour
    prior_weight: Positive = 1e-4  # weight of a displacement of 0 at vertices without observations
    details: DetailOptions = field(default_factory=DetailOptions)
    contours: ContourSearchOptions = field(default_factory=ContourSearchOptions)


@dataclass(frozen=True)
class ResidualOptions(Options):
    """The photometric residual under a flash."""

    edge: Positive = 1.5  # pixels; edge length of the mesh at whose vertices the photographs are sampled
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    surface_error: NotNegative = 0.7  # pixels; tolerated position error of the surface
    averaged: NotNegative = 3.0  # pixels over which the residual is averaged
    forgiven: NotNegative = 6.0  # multiple of the surface's median residual; smaller residuals are noise and gloss
    details: DetailOptions = field(default_factory=DetailOptions)


@dataclass(frozen=True)
class GlossOptions(Options):
    """The fit of a surface's gloss for the textured model."""

    edge: Positive = 3.0  # pixels; edge length of the mesh whose vertices the fit observes
    max_faces: Count = MAX_FACES  # most faces of the mesh with that edge length
    points: Count = 2000  # most points in the fit
    min_observations: Count = 4  # photographs that see a point of the fit
    height: Annotated[int, Range(2)] = 32  # cells of the map's polar angle; the azimuth has twice as many
    smoothness: NotNegative = 0.002  # weight of the squared differences of neighbouring cells, relative to the
    # observations of a cell
    held_out: Annotated[int, Range(2)] = 4  # every n-th photograph is held out to judge the fit
    likely: Annotated[float, Range(1)] = 1.01  # times the least deviation; the mean of the roughnesses below is taken
    possible: Annotated[float, Range(1)] = 1.04  # times the least deviation; roughnesses below are possible too
    worse: Annotated[float, Range(1)] = 1.1  # times the least deviation; above it no larger roughness is tried
    dielectric: Annotated[float, Range(0, 1, open=True)] = 0.04  # reflectance of dielectrics at normal incidence
    metal: Share = 0.8  # reflectance of a metal in its brightest channel; the light's brightness is not known apart
    # from it
    matte_deviation: NotNegative = 0.95  # largest deviation of an accepted gloss, as a multiple of that of a surface
    # without gloss
    outlier: Positive = 0.1  # linear light; larger residuals count no more than this
    first_steps: Count = 40  # most steps of the optimiser from a dark map
    steps: Count = 20  # most steps of the optimiser from the map of another roughness
    tolerance: NotNegative = 1e-5  # relative reduction of the cost at which the optimiser ends


@dataclass(frozen=True)
class StaticLightOptions(Options):
    """The separation of static light from a surface's colours. Source: Retinex, Land and McCann 1971."""

    rays: Count = 256  # rays of each vertex
    reach: NotNegative = 0.5  # edges over which the rays of neighbours are averaged
    places: Annotated[int, Range(2)] = 3000  # number of random vertices between which brightness is compared
    neighbours: Count = 8  # number of neighbours that each of these vertices is compared with
    step: Positive = 0.05  # change of the log albedo above which it counts as a step
    prior: NotNegative = 0.004  # change of the log brightness between neighbours that a light of size 1 must explain to
    # outweigh its own cost
    min_gain: Share = 0.03  # least share of the cost that a light must save against even light
    min_change: NotNegative = 0.01  # least root mean square change of the log brightness that a light must explain
    darkest: Annotated[float, Range(0, 1, open=True)] = 0.3  # least irradiance; division by a smaller one would
    # amplify noise, and narrow clefts, which errors of the surface darken, would become white
    evaluations: Count = 15  # most evaluations of the fit
    height: Annotated[int, Range(4)] = 16  # rows of environment.exr if the surface mirrors no environment
    freedom: Annotated[float, Range(0, 1, open=True)] = 0.05  # cost of a change of that environment's radiance,
    # relative to the same change of a harmonic; some change is needed, because harmonics of low degree are negative in
    # places


@dataclass(frozen=True)
class ShadingConfig(Options):
    """All that reads the photographs' shading."""

    observations: ObservationOptions = field(default_factory=ObservationOptions)
    light: LightOptions = field(default_factory=LightOptions)
    shape: ShadingOptions = field(default_factory=ShadingOptions)
    photometric: PhotometricOptions = field(default_factory=PhotometricOptions)
    residual: ResidualOptions = field(default_factory=ResidualOptions)
