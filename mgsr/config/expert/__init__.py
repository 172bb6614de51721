"""Options of the algorithms: numbers that decide results, but that users need not know.

They are settings like all others (`--set expert.stereo.fusion.bins=16`), and report.json records them. The
documentation lists them apart from what users set, and `GET /options` leaves them out.
"""

from mgsr.config.expert.expert import ExpertConfig
from mgsr.config.expert.geometry import (
    BilateralOptions,
    ContourOptions,
    ContourSearchOptions,
    GeometryConfig,
    LowFrequencyOptions,
)
from mgsr.config.expert.mesh import (
    ColorOptions,
    CutAtGroundOptions,
    MeshOptions,
    MeshStepOptions,
    PullIntoHullOptions,
    RemoveContradictedOptions,
    SurfaceChoiceOptions,
    ViewFitOptions,
)
from mgsr.config.expert.shading import (
    DetailOptions,
    EnvironmentFitOptions,
    EnvironmentNormalOptions,
    EnvironmentOptions,
    EnvironmentResidualOptions,
    FlashFitOptions,
    FlashOptions,
    IrradianceOptions,
    LightOptions,
    ObservationOptions,
    OcclusionOptions,
    PhotometricOptions,
    ResidualOptions,
    ShadingConfig,
    ShadingOptions,
    ShadingPass,
)
from mgsr.config.expert.start import (
    BackgroundPointOptions,
    DepthFillingOptions,
    FirstSurfaceOptions,
    PlaneSweepOptions,
    PointExposureOptions,
    StartConfig,
    ViewColorOptions,
)
from mgsr.config.expert.stereo import (
    ConsistencyOptions,
    FusionOptions,
    MatchSettings,
    PatchMatchOptions,
    StereoConfig,
)

__all__ = [
    "BackgroundPointOptions",
    "BilateralOptions",
    "ColorOptions",
    "ConsistencyOptions",
    "ContourOptions",
    "ContourSearchOptions",
    "CutAtGroundOptions",
    "DepthFillingOptions",
    "DetailOptions",
    "EnvironmentFitOptions",
    "EnvironmentNormalOptions",
    "EnvironmentOptions",
    "EnvironmentResidualOptions",
    "ExpertConfig",
    "FirstSurfaceOptions",
    "FlashFitOptions",
    "FlashOptions",
    "FusionOptions",
    "GeometryConfig",
    "IrradianceOptions",
    "LightOptions",
    "LowFrequencyOptions",
    "MatchSettings",
    "MeshOptions",
    "MeshStepOptions",
    "ObservationOptions",
    "OcclusionOptions",
    "PatchMatchOptions",
    "PhotometricOptions",
    "PlaneSweepOptions",
    "PointExposureOptions",
    "PullIntoHullOptions",
    "RemoveContradictedOptions",
    "ResidualOptions",
    "ShadingConfig",
    "ShadingOptions",
    "ShadingPass",
    "StartConfig",
    "StereoConfig",
    "SurfaceChoiceOptions",
    "ViewColorOptions",
    "ViewFitOptions",
]
