"""The metadata of a run in report.json: the run's settings, machine, input, times and results."""

from __future__ import annotations

import os
import platform
import resource
import shlex
import sys
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import mgsr
from mgsr.config import Config
from mgsr.data.find_cameras import facts_without_cameras
from mgsr.data.readers import find_capture, load_capture
from mgsr.data.scene import Scene
from mgsr.export.far_origin import origin_notes, origin_of_frame
from mgsr.geometry.triangles import topology
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.native.runtime import isas
from mgsr.pipeline.evaluation import ImageScores
from mgsr.pipeline.run_context import RunContext
from mgsr.pipeline.steps import StepClock
from mgsr.pipeline.time_budget import budget_facts
from mgsr.report.data import (
    CurvePoint,
    FlashFacts,
    FrameFacts,
    InputFacts,
    MachineFacts,
    MeshFacts,
    MeshStepRun,
    ReportData,
    Selection,
    StageRun,
    StartFacts,
)
from mgsr.start.points import StartingPoints
from mgsr.training.progress import TrainResult

PACKAGES = ("torch", "numpy", "scipy", "OpenImageIO", "open3d-cpu", "open3d")
# The program's name for each main module.
_PROGRAMS = {"mgsr.cli.main": "mgsr", "program.__main__": "mgsr", "program.worker": "mgsr-worker"}


def run_report(
    run: RunContext, trained: TrainResult, mesh: ReconstructedMesh, scores: ImageScores, gt: dict[str, float] | None
) -> ReportData:
    """Build the content of report.json. gt: the scores of the mesh against the true surface, None without one."""
    config, clock, model = run.config, run.step.clock, trained.model
    return ReportData(
        scene=run.scene.name,
        preset=config.preset,
        method=config.method,
        device=str(run.device),
        seed=config.seed,
        versions=_versions(),
        seconds=_seconds(trained, clock),
        iterations={
            stage.name: StageRun(stage.iterations, stage.stop_reason, stage.dropped) for stage in trained.stages
        },
        gaussians=model.counts,
        psnr_test=scores.psnr_test,
        ssim_test=scores.ssim_test,
        curve=[CurvePoint(psnr=row.psnr, **asdict(row)) for row in trained.curve],
        mesh=MeshFacts(**asdict(topology(mesh))),
        gt=gt,
        peak_memory_mib=peak_memory_mib(),
        command=_command(),
        input=_input(run.scene, run.start, config.output.scale),
        light=str(mesh.light),
        start_kept=mesh.start_kept,
        mesh_steps={
            name: MeshStepRun(step.seconds, step.faces, dict(step.outcome)) for name, step in mesh.steps.items()
        },
        reflection=Selection(model.reflection, trained.tried),
        sh_degree=Selection(
            None if model.gaussians is None else model.gaussians.sh_degree,
            {str(degree): psnr for degree, psnr in trained.degrees.items()},
        ),
        settings=asdict(config),
        machine=_machine(),
        time_budget=None if run.budget is None else budget_facts(run.budget, clock.steps),
        inspection=None if run.inspection is None else run.inspection.to_json(),
        **scores.optional,
    )


def capture_facts(path: Path, config: Config) -> dict[str, Any]:
    """Return the facts of the capture at `path`, by their names for users.

    Cameras that a run would search for are not searched for. Raises SceneError for what a run would refuse.
    """
    found = find_capture(path, config.data)
    if found.kind is None:
        return facts_without_cameras(found)
    return scene_facts(load_capture(found, config.data, options=config.expert.data)).to_json()


def scene_facts(scene: Scene, unit: float = 1.0) -> InputFacts:
    """Return the facts of the scene. unit: the factor on lengths."""
    camera, frame = scene.train[0].camera, scene.user_from_scene
    shown, plain = shown_share(scene), scene.plain_backdrop
    origin, notes = origin_of_frame(frame, unit), [*scene.notes, *origin_notes(frame, unit)]
    return InputFacts(
        path=str(scene.source or scene.root),
        format=scene.format,
        train_views=[view.name for view in scene.train],
        test_views=[view.name for view in scene.test],
        image_size=[camera.width, camera.height],
        masked=scene.masked,
        points=0 if scene.points is None else len(scene.points.positions),
        user_from_scene=FrameFacts(float(frame.scale * unit), [float(x) * unit for x in frame.offset]),
        splats_origin=origin.tolist() if origin.any() else None,
        shown=round(shown, 4) if shown < 1 else None,
        backdrop=None if plain is None else [round(value, 3) for value in plain],
        exposures=None if scene.exposures is None else round(scene.exposures.largest_difference, 3),
        notes=notes or None,
        warning=scene.warning,
        masks_found=scene.masks_found or None,
        mask_error=round(scene.mask_margin, 3) if scene.masks_inexact and not scene.masks_found else None,
        camera_shift=None if scene.camera_shift is None else round(scene.camera_shift, 3),
    )


def shown_share(scene: Scene) -> float:
    """Return the share of valid pixels in the training images; undistortion of a strong lens leaves invalid ones."""
    pixels = sum(view.camera.width * view.camera.height for view in scene.train)
    unknown = sum(int((~view.valid_mask).sum()) for view in scene.train if view.valid_mask is not None)
    return 1 - unknown / max(pixels, 1)


def _input(scene: Scene, start: StartingPoints, unit: float) -> InputFacts:
    """Return the facts of the scene and of its start, in the frame of the written files."""
    flash, lamp = None, start.lighting
    if lamp is not None and scene.train[0].irradiance is not None:
        across = scene.user_from_scene.scale * unit
        flash = FlashFacts(round(across * lamp.right, 4), round(across * lamp.down, 4))
    points = StartFacts(str(start.source), len(start.positions))
    return replace(scene_facts(scene, unit), flash=flash, starting_points=points)


def scene_line(scene: Scene) -> str:
    """Summarise the scene in one line."""
    camera = scene.train[0].camera
    masks = "with masks" if scene.masked else "without masks"
    points = "no points" if scene.points is None else f"{len(scene.points.positions)} points"
    shown = shown_share(scene)
    size = f"{camera.width}x{camera.height}" + (f" ({shown:.0%} of the pixels valid)" if shown < 1 else "")
    return (
        f"{scene.name}: {scene.format}, {len(scene.train)} training and {len(scene.test)} test views, "
        f"{size}, {masks}, {points}"
    )


def peak_memory_mib() -> float:
    """Return the most memory that this process has held, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def _command() -> str:
    # With `python -m`, sys.argv[0] is the module's file instead of the program's name.
    module = getattr(sys.modules["__main__"], "__spec__", None)
    name = _PROGRAMS.get(module.name if module else "", Path(sys.argv[0]).name)
    return shlex.join([name, *sys.argv[1:]])


def _versions() -> dict[str, str]:
    found = {"mgsr": mgsr.__version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _machine() -> MachineFacts:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return MachineFacts(platform.platform(), platform.machine(), cores, isas()[0])


def _seconds(trained: TrainResult, clock: StepClock) -> dict[str, float]:
    """Return seconds by step.

    The total counts this process only; `train` and its stages also include the time before a resume.
    """
    stages = {stage.name: stage.seconds for stage in trained.stages}
    before = trained.seconds - clock.steps["train"]
    return {"total": clock.total + max(0.0, before), **clock.steps, "train": trained.seconds, **stages}
