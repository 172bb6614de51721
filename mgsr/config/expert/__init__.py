"""Options of the algorithms: numbers that decide results, but that users need not know.

They are settings like all others (`--set expert.stereo.fusion.bins=16`), and report.json records them. The
documentation lists them apart from what users set, and `GET /options` leaves them out.
"""

from mgsr.config.expert.expert import ExpertConfig
from mgsr.config.expert.stereo import (
    ConsistencyOptions,
    FusionOptions,
    MatchSettings,
    PatchMatchOptions,
    StereoConfig,
)

__all__ = [
    "ConsistencyOptions",
    "ExpertConfig",
    "FusionOptions",
    "MatchSettings",
    "PatchMatchOptions",
    "StereoConfig",
]
