"""MGSR: photographs in, surface mesh and clean renders out.

Importing this needs nothing else. Each name below is imported from its module when it is first used; docs/python.md
explains them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mgsr.config import Config, DataConfig, make_config
    from mgsr.data.camera import Camera
    from mgsr.data.readers import load_scene
    from mgsr.data.scene import Scene, Similarity, View
    from mgsr.errors import (
        ArchiveError,
        Cancelled,
        CheckpointError,
        ConfigError,
        GpuError,
        LostGpuError,
        MeshError,
        MgsrError,
        MissingPhotoError,
        SceneError,
        TensorError,
        TrainingError,
    )
    from mgsr.export.renders import Rendering
    from mgsr.gaussians.environment_map import EnvironmentMap
    from mgsr.gaussians.gaussians import GaussianModel
    from mgsr.gaussians.surfels import SurfelModel
    from mgsr.gaussians.trained_model import TrainedModel
    from mgsr.geometry.mesh import Mesh
    from mgsr.inspection.findings import Inspection
    from mgsr.inspection.inspect import inspect_scene
    from mgsr.mesh.steps.step import StepReport
    from mgsr.mesh.surface import ReconstructedMesh
    from mgsr.pipeline.novel_view import render
    from mgsr.pipeline.progress import Event
    from mgsr.pipeline.reconstruction import Reconstruction, load_result, reconstruct
    from mgsr.pipeline.result_paths import ResultPaths
    from mgsr.report.data import ReportData
    from mgsr.shading.light_kind import LightKind
    from mgsr.shading.lighting import Lighting

__version__ = "0.1.0"

__all__ = [
    "ArchiveError",
    "Camera",
    "Cancelled",
    "CheckpointError",
    "Config",
    "ConfigError",
    "DataConfig",
    "EnvironmentMap",
    "Event",
    "GaussianModel",
    "GpuError",
    "Inspection",
    "LightKind",
    "Lighting",
    "LostGpuError",
    "Mesh",
    "MeshError",
    "MgsrError",
    "MissingPhotoError",
    "ReconstructedMesh",
    "Reconstruction",
    "Rendering",
    "ReportData",
    "ResultPaths",
    "Scene",
    "SceneError",
    "Similarity",
    "StepReport",
    "SurfelModel",
    "TensorError",
    "TrainedModel",
    "TrainingError",
    "View",
    "__version__",
    "inspect_scene",
    "load_result",
    "load_scene",
    "make_config",
    "reconstruct",
    "render",
]

# Where names are that do not belong to mgsr.errors.
_MODULES = {
    "Camera": "mgsr.data.camera",
    "Config": "mgsr.config",
    "DataConfig": "mgsr.config",
    "Event": "mgsr.pipeline.progress",
    "Mesh": "mgsr.geometry.mesh",
    "EnvironmentMap": "mgsr.gaussians.environment_map",
    "ReconstructedMesh": "mgsr.mesh.surface",
    "Reconstruction": "mgsr.pipeline.reconstruction",
    "Rendering": "mgsr.export.renders",
    "LightKind": "mgsr.shading.light_kind",
    "Lighting": "mgsr.shading.lighting",
    "ReportData": "mgsr.report.data",
    "ResultPaths": "mgsr.pipeline.result_paths",
    "Scene": "mgsr.data.scene",
    "Similarity": "mgsr.data.scene",
    "StepReport": "mgsr.mesh.steps.step",
    "TrainedModel": "mgsr.gaussians.trained_model",
    "SurfelModel": "mgsr.gaussians.surfels",
    "View": "mgsr.data.scene",
    "GaussianModel": "mgsr.gaussians.gaussians",
    "Inspection": "mgsr.inspection.findings",
    "inspect_scene": "mgsr.inspection.inspect",
    "load_result": "mgsr.pipeline.reconstruction",
    "load_scene": "mgsr.data.readers",
    "make_config": "mgsr.config",
    "reconstruct": "mgsr.pipeline.reconstruction",
    "render": "mgsr.pipeline.novel_view",
}


if not TYPE_CHECKING:  # by it, type checkers would take every name for one of these

    def __getattr__(name: str) -> Any:
        """Import a name of `__all__` from its module. Raises AttributeError for any other."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(_MODULES.get(name, "mgsr.errors")), name)
        globals()[name] = value  # found there from now on
        return value


def __dir__() -> list[str]:
    """List the names, also those that are not imported yet."""
    return sorted({*globals(), *__all__})
