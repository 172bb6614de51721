"""The options of all algorithms."""

from __future__ import annotations

from dataclasses import dataclass, field

from mgsr.config.expert.budget import BudgetOptions
from mgsr.config.expert.data import DataOptions
from mgsr.config.expert.geometry import GeometryConfig
from mgsr.config.expert.inspection import InspectionConfig
from mgsr.config.expert.mesh import MeshOptions
from mgsr.config.expert.segmentation import SegmentationConfig
from mgsr.config.expert.shading import ShadingConfig
from mgsr.config.expert.start import StartConfig
from mgsr.config.expert.stereo import StereoConfig
from mgsr.config.expert.training import DensifyOptions, TrainingOptions
from mgsr.config.options import Options


@dataclass(frozen=True)
class ExpertConfig(Options):
    """The options of all algorithms, by the package of the algorithm."""

    data: DataOptions = field(default_factory=DataOptions)
    inspection: InspectionConfig = field(default_factory=InspectionConfig)
    geometry: GeometryConfig = field(default_factory=GeometryConfig)
    shading: ShadingConfig = field(default_factory=ShadingConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    start: StartConfig = field(default_factory=StartConfig)
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)
    densify: DensifyOptions = field(default_factory=DensifyOptions)
    training: TrainingOptions = field(default_factory=TrainingOptions)
    mesh: MeshOptions = field(default_factory=MeshOptions)
    budget: BudgetOptions = field(default_factory=BudgetOptions)
