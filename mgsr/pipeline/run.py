"""A whole run: from a capture to the files of its results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.errors import ConfigError
from mgsr.export.far_origin import about_origin, origin_of_frame
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.metrics.truth import TrueSurface
from mgsr.parallel import one_library_thread
from mgsr.pipeline import result_files
from mgsr.pipeline.device import pick_device
from mgsr.pipeline.evaluation import find_truth, image_scores, surface_scores
from mgsr.pipeline.meshing import make_mesh, make_textured
from mgsr.pipeline.object_files import mask_agreement
from mgsr.pipeline.preprocess import as_read, preprocess, take_scene
from mgsr.pipeline.progress import Event
from mgsr.pipeline.rendering import render_views
from mgsr.pipeline.report_pictures import SurfaceDrawings, draw_relit, draw_surface, report_pictures
from mgsr.pipeline.result_paths import CHECKPOINT, REPORT
from mgsr.pipeline.run_context import RunContext, RunControl
from mgsr.pipeline.run_metadata import run_report
from mgsr.pipeline.steps import StepClock, Steps, always
from mgsr.pipeline.time_budget import fitted_scene, learn_search, make_budget, plan_line, planned_config
from mgsr.report.data import ReportData
from mgsr.training.control import TrainingControl
from mgsr.training.progress import TrainResult
from mgsr.training.run import Training


@one_library_thread()
def run_scene(
    given: Path | Scene,
    out: Path,
    config: Config,
    device: str = "auto",
    control: RunControl = RunControl(),
) -> Path:
    """Reconstruct a scene into the folder `out`; return the path of report.json, which is written last.

    given: the scene, or the path that `load_scene` takes.

    Raises ConfigError, SceneError, TrainingError, MeshError, CheckpointError, GpuError, and Cancelled once
    `control.should_stop` returns True. The checkpoint then holds the training's state.
    """
    result_files.require_packages(config.output)
    if isinstance(given, Scene):
        config = as_read(given, config)
    chosen, resume = pick_device(device), control.resume
    since = StepClock(control.started_at)
    step = Steps(StepClock(), control.progress, control.should_stop)
    budget = make_budget(config, lambda: since.total, chosen, out / CHECKPOINT if resume else None)
    checked = take_scene(given, out, config, step, resume)
    scene = checked.scene
    if budget is not None:
        if not resume:
            learn_search(scene, budget, step.clock)
        scene = fitted_scene(scene, budget, config, step.clock)
    scene, start = preprocess(scene, config, out, step, budget, control.reuse_object)
    if budget is not None:
        with step("plan", "timing an iteration of each stage"):
            config = planned_config(scene, start, budget, config, chosen, step.clock)
        step.progress(Event("plan", f"time budget of {plan_line(budget)}"))
    run = RunContext(scene, start, config, out, step, chosen, budget, checked.inspection)
    training = _TrainingStep(run, resume)
    trained = training.run(before_surface=True)
    if budget is not None:
        run = replace(run, config=replace(config, mesh=budget.mesh_settings()))
    surface = _make_surface(run, trained)
    if budget is not None:
        budget.learn_surface(step.clock.steps["mesh"], step.clock.steps["evaluate"])
    if _set_reflector(run, training, trained, surface.mesh) or budget is not None:
        trained = training.run(before_surface=False)
    return _write_results(run, trained, surface)


def train_only(
    scene_path: Path,
    out: Path,
    config: Config,
    device: str = "auto",
    control: RunControl = RunControl(),
) -> TrainResult:
    """Run the training stages of `run_scene` up to mesh extraction, and write the splats to `out`.

    The arguments and errors are those of `run_scene`. Raises ConfigError for a time budget, because time budgets apply
    to whole runs.
    """
    if config.time_budget is not None:
        raise ConfigError(
            "time_budget applies to whole runs, and `mgsr train` cannot honour it; use `mgsr run`, or choose a preset"
        )
    chosen = pick_device(device)
    step = Steps(StepClock(), control.progress, control.should_stop)
    scene = take_scene(scene_path, out, config, step, control.resume).scene
    scene, start = preprocess(scene, config, out, step)
    return _TrainingStep(RunContext(scene, start, config, out, step, chosen), control.resume).run(before_surface=True)


@dataclass(frozen=True)
class _Surface:
    """The mesh in the user's frame, its scores against the truth, if there is one, and its pictures for the report."""

    mesh: ReconstructedMesh
    scores: dict[str, float] | None
    drawn: SurfaceDrawings


def _make_surface(run: RunContext, trained: TrainResult) -> _Surface:
    """Extract the surface, write it, and measure it."""
    with run.step("mesh", "extracting the surface"):
        go_on = always if run.budget is None else run.budget.go_on
        mesh = make_mesh(run.model(trained), run.scene, run.config, go_on, run.start)
        result_files.write_mesh(run.out, mesh, run.config.output)
    with run.step("evaluate", "scoring the surface"):
        truth = find_truth(run.scene)
        return _Surface(mesh, surface_scores(mesh, truth, run.scene), _draw(mesh, truth, run.scene))


def _set_reflector(run: RunContext, training: _TrainingStep, trained: TrainResult, mesh: ReconstructedMesh) -> bool:
    """Attach the finished mesh as the reflector of the environment map if that is useful.

    Returns whether the map is trained again for it.
    """
    # With a mesh of few faces, or too little time to relearn the map, reflections would be worse than the splats'.
    fit = run.config.mesh.max_faces is None
    if run.budget is not None:
        fit = fit and run.budget.room(run.model(trained).counts) >= run.config.train.environment_map.iterations
    return fit and training.set_reflector(Mesh(run.scene.user_from_scene.to_scene(mesh.vertices), mesh.faces))


def _write_results(run: RunContext, trained: TrainResult, surface: _Surface) -> Path:
    """Texture the model, render and measure the test views, and write the report; return its path."""
    scene = run.scene
    with run.step("model", "texturing the model"):
        levels = make_textured(run.model(trained), scene, run.config, surface.mesh)
        result_files.write_textured(run.out, levels, scene, run.config.output)
    with run.step("render", f"rendering and scoring {len(scene.test)} test views"):
        rendered = list(render_views(run.model(trained), scene.test, run.config))
        result_files.write_renders(run.out, rendered, scene, run.config.output)
        behind = scene.backdrop(run.config.train.background).color
        scores = image_scores(rendered, scene, behind)
    with run.step("report", "writing the report"):
        psnr = [view["psnr"] for view in scores.views.values()]
        maps, agreement = trained.model.environment_map, mask_agreement(run.out)
        relit = draw_relit(levels[0], scene)
        pictures = report_pictures(rendered, psnr, surface.drawn, scene, maps, behind, agreement, relit)
    report = run_report(run, trained, surface.mesh, scores, surface.scores)
    report = replace(report, material=levels[0].material.to_json())
    result_files.write_reports(run.out, report, pictures)
    run.step.progress(Event("report", result_line(report)))
    return run.out / REPORT


def _draw(mesh: ReconstructedMesh, truth: TrueSurface | None, scene: Scene) -> SurfaceDrawings:
    """Draw a mesh of the user's frame.

    Rays are cast in float32, so the mesh is drawn relative to the origin of the scene's files.
    """
    origin = origin_of_frame(scene.user_from_scene)
    mesh = mesh.in_frame(mesh.vertices - origin)
    truth = None if truth is None else replace(truth, mesh=truth.mesh.in_frame(truth.mesh.vertices - origin))
    near = replace(scene, user_from_scene=about_origin(scene.user_from_scene, 1.0, origin))
    return draw_surface(mesh, truth, near)


def result_line(report: ReportData) -> str:
    """Return the run's result in one line."""
    parts = [f"done in {report.seconds['total']:.1f} s"]
    if report.mesh is not None:
        parts.append(f"mesh of {report.mesh.faces} faces")
    given = report.input
    if report.psnr_test is not None and given is not None:
        parts.append(f"PSNR {report.psnr_test:.2f} dB on {len(given.test_views)} test views")
    warning = None if given is None else given.warning
    return ", ".join(parts) + (f"; {warning}" if warning else "")


class _TrainingStep:
    """Training as a step of the run, in one part, or in two parts before and after surface extraction.

    The branches are also written as splat files. `out`/checkpoint holds the state during training and at its end.
    """

    def __init__(self, run: RunContext, resume: bool) -> None:
        self._run, step = run, run.step
        self._text = f"training from {len(run.start.positions)} points ({run.start.source})"
        with step.clock.step("train"):
            control = TrainingControl(
                lambda training: step.progress(Event("train", training.stage, training)),
                step.should_stop,
                run.out / CHECKPOINT,
                resume,
                scheduler=run.budget,
            )
            self._training = Training(run.scene, run.start, run.config, control, run.device.torch)

    def set_reflector(self, mesh: Mesh) -> bool:
        """Let the finished mesh reflect the environment map (`Training.set_reflector`)."""
        return self._training.set_reflector(mesh)

    def run(self, before_surface: bool = False) -> TrainResult:
        """Return the branches after all stages, or with `before_surface` after the stages before the surface."""
        run = self._run
        with run.step("train", self._text):
            trained = self._training.run(finish=not before_surface)
        self._text = "training continues"
        with run.step("export", "writing the splats"):
            result_files.write_models(run.out, trained.model, run.scene, run.config.output)
        return trained
