"""The Python interface: reconstruct a capture, and read a folder of results."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mgsr.config import SurfaceDepth, make_config, override_texts
from mgsr.config.expert import IrradianceOptions
from mgsr.data.scene import Scene, Similarity
from mgsr.errors import ConfigError, MgsrError, in_short
from mgsr.export.far_origin import origin_of_frame
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.mesh.steps.step import StepReport
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.pipeline.device import pick_device
from mgsr.pipeline.progress import Event, EventCallback
from mgsr.pipeline.result_files import read_lighting, read_mesh, read_models, read_report
from mgsr.pipeline.result_paths import ResultPaths
from mgsr.pipeline.run import run_scene
from mgsr.pipeline.run_context import RunControl
from mgsr.pipeline.run_log import RunLog
from mgsr.pipeline.steps import never
from mgsr.report.data import ReportData
from mgsr.shading.light_kind import LightKind
from mgsr.shading.lighting import Lighting


@dataclass(frozen=True)
class Reconstruction:
    """A finished run's results, in the capture's frame and unit.

    mesh: the surface; `paths.model_glb` has it with a texture.
    model: the 2D branch, the 3D branch, and the environment map that a shiny surface reflects; each may be None.
    origin [3] float64: the point to which means and the reflector are relative, so positions are `means + origin`. It
    is zero unless the capture lies far from its frame's origin.
    flash: the lamp beside the lens and the surface that it lights; None if the photographs show no flash.
    report: the content of report.json.
    paths: the files.
    normalisation: frame = scale * normalised + offset. In the normalised frame the object lies in the unit ball, and
    splats are trained and rendered.
    """

    mesh: ReconstructedMesh
    model: TrainedModel
    flash: Lighting | None
    report: ReportData
    paths: ResultPaths
    origin: np.ndarray
    normalisation: Similarity

    def to(self, device: str) -> Reconstruction:
        """Return the same results with the model on a device: auto, cpu or cuda. It renders there.

        Raises ConfigError for another name or a device that torch does not see, and GpuError for a GPU that can't be
        used.
        """
        return replace(self, model=self.model.to(pick_device(device).torch))

    @property
    def surfels(self) -> SurfelModel | None:
        """Return the 2D branch."""
        return self.model.surfels

    @property
    def gaussians(self) -> GaussianModel | None:
        """Return the 3D branch."""
        return self.model.gaussians

    @property
    def environment_map(self) -> EnvironmentMap | None:
        """Return the environment map that the surface reflects."""
        return self.model.environment_map

    @cached_property
    def normalised_model(self) -> TrainedModel:
        """Return the model in the normalised frame, where it is rendered."""
        frame = Similarity(self.normalisation.scale, self.normalisation.offset - self.origin)
        return self.model.to_scene(frame)

    @cached_property
    def normalised_flash(self) -> Lighting | None:
        """Return the flash in the normalised frame."""
        return None if self.flash is None else self.flash.moved(self.normalisation.inverse)

    @property
    def surface_depth(self) -> SurfaceDepth:
        """Return which depth of the surfels is the surface."""
        return SurfaceDepth((self.report.settings or {})["train"]["paper"]["surface_depth"])


def reconstruct(
    scene: Scene | str | os.PathLike[str],
    out: str | os.PathLike[str],
    preset: str = "standard",
    *,
    method: str = "mgsr",
    device: str = "auto",
    seed: int = 0,
    time_budget: float | None = None,
    overrides: Mapping[str, object] | Sequence[str] = (),
    resume: bool = False,
    progress: EventCallback | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Reconstruction:
    """Reconstruct a capture into the folder `out`, as `mgsr run` does, and return the results.

    scene: the result of `load_scene`, or the path of a folder or an archive.
    preset: draft, standard or high.
    method: mgsr, 2dgs or 3dgs.
    device: auto, cpu or cuda.
    seed: the same seed gives the same files.

    time_budget: seconds from this call after which the run should end; it replaces the preset.
    overrides: settings by name or path, such as {"mesh.max_faces": 50_000, "output.obj": True}, or as texts
    "key=value"; None is "none". Most settings of `data` take effect while a scene is read. For a loaded scene they
    must equal its own, except `exposure`, `object` and `object_box`.
    resume: continue from the checkpoint in `out`, if there is one.
    progress: called with an `Event` at each step and at intervals during training.
    should_stop: called between iterations. Once it returns True, a checkpoint is written and Cancelled raised.

    Raises ConfigError for an invalid argument or setting, SceneError for a capture that can't be used, TrainingError,
    MeshError, CheckpointError, GpuError, and Cancelled.
    """
    started_at = time.perf_counter()
    folder = _path("out", out)
    given = scene if isinstance(scene, Scene) else _path("scene", scene, "a Scene or ")
    budget = [] if time_budget is None else [f"time_budget={time_budget}"]
    config = make_config(preset, method, seed, [*override_texts(overrides), *budget])
    with RunLog(ResultPaths(folder).log, append=resume) as log:

        def tell(event: Event) -> None:
            log(event)
            if progress is not None:
                progress(event)

        control = RunControl(resume, tell, should_stop or never, started_at)
        run_scene(given, folder, config, device, control)
    return load_result(folder)


def load_result(out: str | os.PathLike[str]) -> Reconstruction:
    """Read the results that a finished run left in the folder `out`.

    Raises MgsrError if the folder has no report, which a run writes last, and for files that are not a run's results.
    Raises SceneError for a damaged flash.
    """
    folder = _path("out", out)
    report = read_report(folder)
    try:
        if report.input is None or report.light is None or report.start_kept is None or report.mesh_steps is None:
            raise KeyError("input, light, start_kept or mesh_steps")
        settings = report.settings or {}
        unit = float(settings["output"]["scale"])
        frame = report.input.user_from_scene
        normalisation = Similarity(frame.scale / unit, np.array(frame.offset, np.float64) / unit)
        steps = {name: StepReport(**vars(step)) for name, step in report.mesh_steps.items()}
        light = LightKind(report.light)
        shading = settings["expert"]["shading"]
        irradiance = IrradianceOptions(**shading["light"]["flash"]["irradiance"])
    except (LookupError, TypeError, ValueError) as error:
        raise MgsrError(f"{folder}: the report is of another version ({in_short(error)}); run again") from error
    origin = origin_of_frame(normalisation)
    return Reconstruction(
        mesh=read_mesh(folder).with_report(light, report.start_kept, steps),
        model=read_models(folder, Similarity(offset=origin)),
        flash=read_lighting(folder, irradiance),
        report=report,
        paths=ResultPaths(folder),
        origin=origin,
        normalisation=normalisation,
    )


def _path(name: str, given: object, alternative: str = "") -> Path:
    """Return an argument as a path. Raises ConfigError for anything else."""
    if not isinstance(given, str | os.PathLike):
        raise ConfigError(f"{name}: expected {alternative}a path, got {type(given).__name__}")
    return Path(given)
