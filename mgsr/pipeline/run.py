"""The whole way from a scene to its results, as steps that the single commands share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsr.budget.budget import TimeBudget
from mgsr.config import Config
from mgsr.data.backdrop import backdrop
from mgsr.data.scene import Scene
from mgsr.errors import ConfigError
from mgsr.export.far_origin import about_origin, origin_notes, origin_of_frame
from mgsr.geometry.triangles import Triangles
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface import SurfaceMesh
from mgsr.mesh.texture import require_unfolding, texture_mesh
from mgsr.metrics.truth import TrueSurface
from mgsr.pipeline import result_files
from mgsr.pipeline.device import Device, pick_device
from mgsr.pipeline.evaluation import find_truth, image_scores, surface_scores
from mgsr.pipeline.models import Models
from mgsr.pipeline.preprocess import preprocess, read_scene
from mgsr.pipeline.progress import Event, EventCallback, ignore
from mgsr.pipeline.rendering import outlined_scene, render_views, scene_silhouettes, surface_views
from mgsr.pipeline.report_pictures import SurfaceDrawings, draw_surface, report_pictures
from mgsr.pipeline.run_metadata import run_report
from mgsr.pipeline.steps import StepClock, Steps, StopCheck, always, never
from mgsr.pipeline.time_budget import budget_report, fitted_scene, make_budget, plan_line, planned_config
from mgsr.report.data import ReportData
from mgsr.start.starting_points import StartingPoints
from mgsr.training.progress import TrainResult
from mgsr.training.run import Training


def run_scene(
    scene_path: Path,
    out: Path,
    config: Config,
    device: str = "auto",
    resume: bool = False,
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
    deadline: float | None = None,
    begun: float | None = None,
) -> Path:
    """Reconstruct the scene into the folder `out`; the path of report.json, which is written last.

    resume: go on from the checkpoint in `out`, if there is one. should_stop: looked at between iterations and between
    steps. deadline: seconds of training after which it ends where it is. begun: what time.perf_counter() said when the
    caller began, from where a time budget counts (config.time_budget); None is now.

    Raises ConfigError, SceneError, TrainingError, MeshError, CheckpointError, GpuError, and Cancelled once should_stop
    says so (the checkpoint then holds what was trained).
    """
    if config.output.texture is not None:
        require_unfolding()
    chosen = pick_device(device)
    since = StepClock(begun)
    step = Steps(StepClock(), progress, should_stop)
    budget = make_budget(config, lambda: since.total, chosen, out / result_files.CHECKPOINT if resume else None)
    scene = _load(scene_path, out, config, step)
    if budget is not None:
        scene = fitted_scene(scene, budget, config, step.clock)
    scene, start = preprocess(scene, config, out, step, budget)
    if budget is not None:
        with step("plan", "timing an iteration of each stage"):
            config = planned_config(scene, start, budget, config, chosen, step.clock)
        progress(Event("plan", f"time budget of {plan_line(budget)}"))
    training = _Training(scene, start, config, out, step, chosen, resume, deadline, budget)
    trained = training.run(before_surface=True)
    models = Models(trained.surfels, trained.volumes, trained.light).to(chosen.torch)
    if budget is not None:
        config = replace(config, mesh=budget.mesh_settings())
    with step("mesh", "extracting the surface"):
        begun_on = start.surface if scene.masked else None
        mesh = make_mesh(models, scene, config, always if budget is None else budget.go_on, begun_on)
        result_files.write_mesh(out, mesh, scene, config.output)
    with step("evaluate", "measuring the surface"):
        truth = find_truth(scene)
        scores = surface_scores(mesh, truth, scene)
        drawn = _draw(mesh, truth, scene)
    if budget is not None:
        budget.learn_surface(step.clock.steps["mesh"], step.clock.steps["evaluate"])
    # A mesh of few faces, or too little time to learn the light anew, would mirror worse than the splats.
    fit = config.mesh.max_faces is None
    if budget is not None:
        fit = fit and budget.room(models.counts) >= config.train.mirror.iterations
    mirrors = fit and training.mirror_at(scene.user_from_scene.to_scene(mesh.vertices), mesh.faces)
    if budget is not None or mirrors:
        trained = training.run(before_surface=False)
        models = Models(trained.surfels, trained.volumes, trained.light).to(chosen.torch)
    with step("render", f"rendering and measuring {len(scene.test)} test views"):
        rendered = list(render_views(models, scene.test, config))
        result_files.write_renders(out, rendered, scene, config.output)
        behind = backdrop(scene, config.train.background).color
        scores |= image_scores(rendered, scene, behind)
    with step("report", "writing the report"):
        psnr = [view["psnr"] for view in scores["views"].values()]
        pictures = report_pictures(rendered, psnr, drawn, scene, trained.light, behind)
    kept = None if budget is None else budget_report(budget, step.clock.steps)
    report = run_report(scene, start, scene_path, config, chosen, trained, mesh, scores, step.clock, kept)
    result_files.write_reports(out, report, pictures)
    progress(Event("report", result_line(report)))
    return out / result_files.REPORT


def train_only(
    scene_path: Path,
    out: Path,
    config: Config,
    device: str = "auto",
    resume: bool = False,
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
) -> TrainResult:
    """Train as `run_scene` does before it makes the surface, and leave the splats in `out`; the same arguments and
    errors, but a time budget is refused: it is for whole runs."""
    if config.time_budget is not None:
        raise ConfigError("time_budget: training alone keeps to none; use `mgsr run`, or a preset")
    chosen = pick_device(device)
    step = Steps(StepClock(), progress, should_stop)
    scene = _load(scene_path, out, config, step)
    scene, start = preprocess(scene, config, out, step)
    return _Training(scene, start, config, out, step, chosen, resume).run(before_surface=True)


def _load(path: Path, out: Path, config: Config, step: Steps) -> Scene:
    """Return the scene, told of, and of the origin of the files that will be written."""
    scene = read_scene(path, out, config, step)
    for text in origin_notes(scene.user_from_scene, config.output.scale):
        step.progress(Event("load", text))
    return scene


def _draw(mesh: SurfaceMesh, truth: TrueSurface | None, scene: Scene) -> SurfaceDrawings:
    """Return pictures of a mesh of the user's frame. They are drawn about the origin of the scene's files, as rays are
    cast in float32."""
    origin = origin_of_frame(scene.user_from_scene)
    mesh = replace(mesh, vertices=mesh.vertices - origin)
    truth = None if truth is None else replace(truth, vertices=truth.vertices - origin)
    near = replace(scene, user_from_scene=about_origin(scene.user_from_scene, 1.0, origin))
    return draw_surface(mesh, truth, near)


def make_mesh(
    models: Models,
    scene: Scene,
    config: Config,
    go_on: Callable[[], bool] = always,
    start: Triangles | None = None,
) -> SurfaceMesh:
    """Extract the surface, in the user's frame.

    go_on: whether there is time for another round of refinement; start: as for `extract_mesh`. Raises MeshError, with
    the reason, where none comes out.
    """
    views = surface_views(models, scene, config)
    outlined = outlined_scene(models, scene, config)
    mesh = extract_mesh(views, config.mesh, scene_silhouettes(outlined), outlined.train, go_on=go_on, start=start)
    to_user = scene.user_from_scene.to_user
    textured = None
    if config.output.texture is not None:
        textured = texture_mesh(mesh, views, config.output.texture, config.output.texture_faces, config.mesh)
        textured = replace(textured, vertices=to_user(textured.vertices))
    return replace(mesh, vertices=to_user(mesh.vertices), textured=textured)


def result_line(report: ReportData) -> str:
    """Return the run's result in one line."""
    parts = [f"done in {report.seconds['total']:.1f} s"]
    if report.mesh is not None:
        parts.append(f"mesh of {report.mesh.faces} faces")
    if report.psnr_test is not None:
        parts.append(f"PSNR {report.psnr_test:.2f} dB on {len(report.other['input']['test_views'])} test views")
    warning = report.other["input"].get("warning")
    return ", ".join(parts) + (f"; {warning}" if warning else "")


class _Training:
    """Training as a step of the run, which may have two parts: before and after the surface. The branches are also
    written as splats; `out`/checkpoint holds them on the way and at the end."""

    def __init__(
        self,
        scene: Scene,
        start: StartingPoints,
        config: Config,
        out: Path,
        step: Steps,
        device: Device,
        resume: bool,
        deadline: float | None = None,
        budget: TimeBudget | None = None,
    ) -> None:
        self._scene, self._out, self._step, self._output = scene, out, step, config.output
        self._text = f"training from {len(start.positions)} points ({start.source})"
        with step.clock.step("train"):
            self._training = Training(
                scene,
                start,
                config,
                progress=lambda training: step.progress(Event("train", training.stage, training)),
                should_stop=step.should_stop,
                checkpoint_path=out / result_files.CHECKPOINT,
                resume=resume,
                deadline=deadline,
                device=device.torch,
                pace=budget,
            )

    def mirror_at(self, vertices: np.ndarray, faces: np.ndarray) -> bool:
        """See `Training.mirror_at`."""
        return self._training.mirror_at(vertices, faces)

    def run(self, before_surface: bool = False) -> TrainResult:
        """Return the branches after all stages, or with `before_surface` after those that the surface is made from."""
        with self._step("train", self._text):
            trained = self._training.run(finish=not before_surface)
        self._text = "training goes on"
        with self._step("export", "writing the splats"):
            models = Models(trained.surfels, trained.volumes, trained.light)
            result_files.write_models(self._out, models, self._scene, self._output)
        return trained
