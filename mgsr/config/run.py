"""All settings of one run, and what presets and methods change."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.capture import DataConfig
from mgsr.config.expert import ExpertConfig
from mgsr.config.surface import MeshConfig, OutputConfig
from mgsr.config.train import TrainConfig


@dataclass(frozen=True)
class Config:
    """All settings of one run."""

    preset: str = "standard"
    method: str = "mgsr"
    seed: int = 0
    # The seconds that the whole run should take. MGSR then plans the settings that presets change and the size of the
    # photographs. none: no limit.
    time_budget: float | None = None
    data: DataConfig = field(default_factory=DataConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    mesh: MeshConfig = field(default_factory=MeshConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    expert: ExpertConfig = field(default_factory=ExpertConfig)


# What each preset changes. Times are those of a whole run with 48 views of 256 x 256 pixels on two cores. Slow cores
# take up to twice as long.
PRESETS: dict[str, dict[str, str]] = {
    "draft": {  # 25 to 50 seconds
        "warmup.surfel_iterations": "250",
        "warmup.gaussian_iterations": "300",
        "mutual.iterations": "200",
        "model_selection.iterations": "0",
        "environment_map.iterations": "100",
        "surfels.max_start": "9000",
        "surfels.start_scale": "0.5",
        "gaussians.max_start": "5000",
        "gaussians.sh_degree": "1",  # model selection finds the same where there is time for it
        "surfels.unmasked_start": "15000",
        "gaussians.unmasked_start": "25000",
        "expert.start.stereo.max_pixels": "700000",
        "expert.start.usual_pixels": "240000",  # fewer surfels for large photographs
        "surfels.densify.prune_contribution": "0",  # a short mutual phase cannot repair the loss
        "gaussians.densify.prune_contribution": "0",
        "mesh.view_scale": "1.0",
        "mesh.poisson_depth": "7",
        "mesh.max_light_residual": "none",  # the start is already refined by shading, and little training follows
    },
    "standard": {},  # two to three minutes
    "high": {  # up to a fifth longer; longer training makes surfaces rougher and renders hardly better
        "surfels.max_start": "32000",
        "gaussians.max_start": "20000",
        "gaussians.densify.tolerance": "0.02",
        "gaussians.densify.max_growth": "3",
    },
}


METHODS: dict[str, dict[str, str]] = {
    "mgsr": {},
    "2dgs": {"branches": "surfels", "flash": "off"},
    "3dgs": {
        "branches": "gaussians",
        "reflection": "off",
        "flash": "off",
        "gaussians.sh_degree": "3",
        "transmitted_tv_weight": "0",
        "gaussians.densify.by": "gradient",
        "gaussians.densify.max_growth": "none",
        "gaussians.densify.prune_contribution": "0",
    },
}
