"""The options of all algorithms."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert.stereo import StereoConfig
from mgsr.config.options import Options


@dataclass(frozen=True)
class ExpertConfig(Options):
    """The options of all algorithms, by the package of the algorithm."""

    stereo: StereoConfig = field(default_factory=StereoConfig)
