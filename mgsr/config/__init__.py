"""Every setting with its default, unit and meaning. Only the command line, the service and the worker build these.

`make_config` puts a run's settings together: the defaults, then the preset's row of PRESETS, then the method's row of
METHODS, then the caller's ``key=value`` overrides. ABLATIONS has the paper's rows as such overrides.
"""

from mgsr.config.capture import DataConfig, Exposure, Flawed, Masks, Object, object_box
from mgsr.config.expert import ExpertConfig
from mgsr.config.making import ablation_overrides, make_config
from mgsr.config.overrides import EXPERT, RENAMED, apply_overrides, field_types, override_texts
from mgsr.config.paper import (
    ABLATIONS,
    AlphaLoss,
    DepthUnit,
    PaperConfig,
    StopRule,
    SurfaceDepth,
    Teaching,
)
from mgsr.config.run import METHODS, PRESETS, Config
from mgsr.config.surface import MIN_TEXTURE, Extractor, MeshColor, MeshConfig, OutputConfig, Up
from mgsr.config.train import (
    Background,
    Branches,
    DensifyConfig,
    EnvironmentMapConfig,
    GaussianConfig,
    GaussianDensifyConfig,
    Growth,
    ModelSelectionConfig,
    MutualConfig,
    RatesConfig,
    Reflection,
    SurfelConfig,
    TrainConfig,
    WarmupConfig,
    WatchConfig,
    starting_settings,
)
from mgsr.config.validation import validate

__all__ = [
    "ABLATIONS",
    "EXPERT",
    "METHODS",
    "MIN_TEXTURE",
    "PRESETS",
    "RENAMED",
    "AlphaLoss",
    "Background",
    "Branches",
    "Config",
    "DataConfig",
    "DensifyConfig",
    "DepthUnit",
    "EnvironmentMapConfig",
    "ExpertConfig",
    "Exposure",
    "Extractor",
    "Flawed",
    "GaussianConfig",
    "GaussianDensifyConfig",
    "Growth",
    "Masks",
    "MeshColor",
    "MeshConfig",
    "ModelSelectionConfig",
    "MutualConfig",
    "Object",
    "OutputConfig",
    "PaperConfig",
    "RatesConfig",
    "Reflection",
    "StopRule",
    "SurfaceDepth",
    "SurfelConfig",
    "Teaching",
    "TrainConfig",
    "Up",
    "WarmupConfig",
    "WatchConfig",
    "ablation_overrides",
    "apply_overrides",
    "field_types",
    "make_config",
    "object_box",
    "override_texts",
    "starting_settings",
    "validate",
]
