"""The whole way from a scene to its results, as steps that the single commands share."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.cli import outputs
from mgsr.cli.clock import StepClock
from mgsr.cli.device import pick_device
from mgsr.cli.evaluation import image_scores, surface_scores
from mgsr.cli.events import Event, EventCallback, ignore
from mgsr.cli.facts import run_facts, scene_line
from mgsr.cli.models import Models
from mgsr.cli.rendering import RenderedView, render_views, scene_silhouettes, surface_views
from mgsr.config import Config
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.data.starting_points import starting_points
from mgsr.errors import Cancelled
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface import SurfaceMesh, topology
from mgsr.training.progress import TrainResult
from mgsr.training.run import train

StopCheck = Callable[[], bool]


def never() -> bool:
    """For callers that will not stop a run."""
    return False


def run_scene(
    scene_path: Path,
    out: Path,
    config: Config,
    device: str = "auto",
    resume: bool = False,
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
    deadline: float | None = None,
) -> Path:
    """Reconstruct the scene into the folder `out`; the path of report.json, which is written last.

    resume: go on from the checkpoint in `out`, if there is one. should_stop: looked at between iterations and between
    steps. deadline: seconds of training after which it ends where it is.

    Raises ConfigError, SceneError, TrainingError, MeshError, CheckpointError, and Cancelled once should_stop says so
    (the checkpoint then holds what was trained).
    """
    chosen = pick_device(device)
    step = _Steps(StepClock(), progress, should_stop)
    with step("load", f"reading {scene_path}"):
        scene = load_scene(scene_path, config.data)
        outputs.clear_reports(out)
    progress(Event("load", scene_line(scene)))
    trained = train_scene(scene, config, out, step, progress, should_stop, resume, deadline)
    models = Models(trained.surfels, trained.volumes)
    with step("export", "writing the splats"):
        outputs.write_models(out, models, scene)
    with step("render", f"rendering {len(scene.test)} test views"):
        rendered = list(render_views(models, scene.test, config))
        outputs.write_renders(out, rendered, scene)
    with step("mesh", "extracting the surface"):
        mesh = make_mesh(models, scene, config)
        outputs.write_mesh_files(out, mesh, scene)
    with step("evaluate", "measuring"):
        scores = evaluate(rendered, mesh, scene)
    facts = run_facts(scene, scene_path, config, chosen, trained, step.clock)
    report = facts | {"mesh": mesh_facts(mesh)} | scores
    outputs.write_reports(out, report, rendered, scene)
    progress(Event("report", result_line(report)))
    return out / outputs.REPORT


def train_scene(
    scene: Scene,
    config: Config,
    out: Path,
    step: StepRunner,
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
    resume: bool = False,
    deadline: float | None = None,
) -> TrainResult:
    """The trained branches; `out`/checkpoint holds them on the way and at the end."""
    with step("start", "choosing starting points"):
        settings = config.train
        start = starting_points(scene, max(settings.surfels.max_start, settings.volumes.max_start), config.seed)
    with step("train", f"training from {len(start.positions)} points"):
        return train(
            scene,
            start,
            config,
            progress=lambda training: progress(Event("train", training.stage, training)),
            should_stop=should_stop,
            checkpoint_path=out / outputs.CHECKPOINT,
            resume=resume,
            deadline=deadline,
        )


def make_mesh(models: Models, scene: Scene, config: Config) -> SurfaceMesh:
    """The surface in the scene's frame. Raises MeshError, with the reason, where none comes out."""
    return extract_mesh(surface_views(models, scene, config), config.mesh, scene_silhouettes(scene))


def evaluate(rendered: list[RenderedView], mesh: SurfaceMesh, scene: Scene) -> dict[str, Any]:
    """psnr_test, ssim_test and the like; gt and split where the scene has the truth for them."""
    user_mesh = outputs.in_user_frame(mesh, scene)
    return image_scores(rendered, scene) | surface_scores(user_mesh.vertices, user_mesh.faces, scene)


def mesh_facts(mesh: SurfaceMesh) -> dict[str, int]:
    """Counts of vertices, faces, components, boundary edges and holes."""
    counts = topology(mesh.vertices, mesh.faces)
    return {name: int(value) for name, value in vars(counts).items()}


def result_line(report: dict[str, Any]) -> str:
    """The run's result in one line."""
    parts = [f"done in {report['seconds']['total']:.1f} s", f"mesh of {report['mesh']['faces']} faces"]
    if report.get("psnr_test") is not None:
        parts.append(f"PSNR {report['psnr_test']:.2f} dB on {len(report['input']['test_views'])} test views")
    return ", ".join(parts)


StepRunner = Callable[[str, str], AbstractContextManager[None]]


class _Steps:
    """Announces each step, times it, and heeds the wish to stop before it begins."""

    def __init__(self, clock: StepClock, progress: EventCallback, should_stop: StopCheck) -> None:
        self.clock = clock
        self._progress = progress
        self._should_stop = should_stop

    def __call__(self, step: str, text: str) -> AbstractContextManager[None]:
        if self._should_stop():
            raise Cancelled(f"stopped on request before the step {step}")
        self._progress(Event(step, text))
        return self.clock.step(step)
