"""The whole way from a scene to its results, as steps that the single commands share."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mgsr.budget.budget import TimeBudget
from mgsr.cli import outputs
from mgsr.cli.budgeted import budget_report, fitted_scene, make_budget, most_points, plan_line, planned_config
from mgsr.cli.clock import StepClock
from mgsr.cli.device import Device, pick_device
from mgsr.cli.evaluation import find_truth, image_scores, surface_scores
from mgsr.cli.events import Event, EventCallback, ignore
from mgsr.cli.facts import run_report, scene_line
from mgsr.cli.gallery import draw_surface, report_pictures
from mgsr.cli.models import Models
from mgsr.cli.rendering import outlined_scene, render_views, scene_silhouettes, surface_views
from mgsr.config import Config, Exposure
from mgsr.data.backdrop import backdrop
from mgsr.data.exposure import evened
from mgsr.data.masks import with_masks
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import Cancelled, ConfigError
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface import SurfaceMesh
from mgsr.mesh.texture import require_unfolding, texture_mesh
from mgsr.report.data import ReportData
from mgsr.start.starting_points import StartingPoints, starting_points
from mgsr.training.exposure import find_exposures
from mgsr.training.outlines import learned_outlines
from mgsr.training.progress import TrainResult
from mgsr.training.run import Training

StopCheck = Callable[[], bool]

# Seconds between two words of how far a long step is.
SELDOM = 2.0


def never() -> bool:
    """For callers that will not stop a run."""
    return False


def always() -> bool:
    """For callers that have all the time there is."""
    return True


class Steps:
    """Announces each step, times it, and heeds the wish to stop before it begins."""

    def __init__(self, clock: StepClock, progress: EventCallback, should_stop: StopCheck) -> None:
        self.clock = clock
        self.progress = progress
        self.should_stop = should_stop

    def __call__(self, step: str, text: str) -> AbstractContextManager[None]:
        if self.should_stop():
            raise Cancelled(f"stopped on request before the step {step}")
        self.progress(Event(step, text))
        return self.clock.step(step)

    def share(self, step: str, text: str) -> Callable[[float], None]:
        """What a long step calls with the share of it that is done, 0..1: passed on now and then; heeds the wish to
        stop, too."""
        told = time.monotonic()

        def tell(done: float) -> None:
            nonlocal told
            if self.should_stop():
                raise Cancelled(f"stopped on request in the step {step}")
            if time.monotonic() - told > SELDOM:
                told = time.monotonic()
                self.progress(Event(step, f"{text}: {done:.0%}", done=done))

        return tell


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
    budget = make_budget(config, lambda: since.total, chosen, out / outputs.CHECKPOINT if resume else None)
    scene = _load(scene_path, out, config, step)
    if budget is not None:
        scene = fitted_scene(scene, budget, step.clock)
    scene, start = _begin(scene, config, out, step, budget)
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
        mesh = make_mesh(models, scene, config, always if budget is None else budget.go_on)
        outputs.write_mesh(out, mesh, scene, config.output)
    with step("evaluate", "measuring the surface"):
        truth = find_truth(scene)
        scores = surface_scores(mesh, truth, scene)
        drawn = draw_surface(mesh, truth, scene)
    if budget is not None:
        budget.learn_surface(step.clock.steps["mesh"], step.clock.steps["evaluate"])
        trained = training.run(before_surface=False)
        models = Models(trained.surfels, trained.volumes, trained.light).to(chosen.torch)
    with step("render", f"rendering and measuring {len(scene.test)} test views"):
        rendered = list(render_views(models, scene.test, config))
        outputs.write_renders(out, rendered, scene, config.output)
        behind = backdrop(scene, config.train.background).color
        scores |= image_scores(rendered, scene, behind)
    with step("report", "writing the report"):
        psnr = [view["psnr"] for view in scores["views"].values()]
        pictures = report_pictures(rendered, psnr, drawn, scene, trained.light, behind)
    kept = None if budget is None else budget_report(budget, step.clock.steps)
    report = run_report(scene, start, scene_path, config, chosen, trained, mesh, scores, step.clock, kept)
    outputs.write_reports(out, report, pictures)
    progress(Event("report", result_line(report)))
    return out / outputs.REPORT


def train_only(
    scene_path: Path,
    out: Path,
    config: Config,
    device: str = "auto",
    resume: bool = False,
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
) -> TrainResult:
    """Train as `run_scene` does, and leave the splats in `out`; the same arguments and errors, but a time budget is
    refused: it is for whole runs."""
    if config.time_budget is not None:
        raise ConfigError("time_budget: training alone keeps to none; use `mgsr run`, or a preset")
    chosen = pick_device(device)
    step = Steps(StepClock(), progress, should_stop)
    scene = _load(scene_path, out, config, step)
    scene, start = _begin(scene, config, out, step)
    return _Training(scene, start, config, out, step, chosen, resume).run()


def make_mesh(models: Models, scene: Scene, config: Config, go_on: Callable[[], bool] = always) -> SurfaceMesh:
    """The surface in the user's frame; go_on: whether there is time for another round of refinement. Raises MeshError,
    with the reason, where none comes out."""
    views = surface_views(models, scene, config)
    outlined = outlined_scene(models, scene, config)
    mesh = extract_mesh(views, config.mesh, scene_silhouettes(outlined), outlined.train, go_on=go_on)
    to_user = scene.user_from_scene.to_user
    textured = None
    if config.output.texture is not None:
        textured = texture_mesh(mesh, views, config.output.texture, config.output.texture_faces, config.mesh)
        textured = replace(textured, vertices=to_user(textured.vertices))
    return replace(mesh, vertices=to_user(mesh.vertices), textured=textured)


def result_line(report: ReportData) -> str:
    """The run's result in one line."""
    parts = [f"done in {report.seconds['total']:.1f} s"]
    if report.mesh is not None:
        parts.append(f"mesh of {report.mesh.faces} faces")
    if report.psnr_test is not None:
        parts.append(f"PSNR {report.psnr_test:.2f} dB on {len(report.other['input']['test_views'])} test views")
    return ", ".join(parts)


def _load(path: Path, out: Path, config: Config, step: Steps) -> Scene:
    with step("load", f"reading {path}"):
        scene = load_scene(path, config.data, progress=lambda done, total: step.progress(_loading(done, total)))
        outputs.clear_reports(out)
    for text in (scene_line(scene), *scene.notes):
        step.progress(Event("load", text))
    return scene


def _loading(done: int, total: int) -> Event:
    return Event("load", f"read {done} of {total} photographs", done=done / total)


def _begin(
    scene: Scene, config: Config, out: Path, step: Steps, budget: TimeBudget | None = None
) -> tuple[Scene, StartingPoints]:
    """The scene with its photographs at a common exposure, where theirs differ, and the points to start from."""
    masks = _learn_masks(scene, config, step)

    def points(of: Scene, during: str, text: str) -> StartingPoints:
        count, progress = most_points(config, budget), step.share(during, text)
        return starting_points(with_masks(of, masks), count, config.seed, progress, config.train.background)

    outputs.clear_exposures(out)
    with step("start", "choosing starting points"):
        start = points(scene, "start", "choosing starting points")
    if config.data.exposure is Exposure.KEEP:
        return scene, start
    with step("exposures", "comparing the photographs' exposures"):
        exposures = find_exposures(scene, start, config.seed, step.should_stop)
        if exposures is None:
            return scene, start
        scene = evened(scene, exposures)
        outputs.write_exposures(out, scene, exposures)
        text = f"exposures differ, up to {exposures.largest_difference:.2f} times: all are brought to a common one"
        step.progress(Event("exposures", text))
        return scene, points(scene, "exposures", "choosing starting points anew")


def _learn_masks(scene: Scene, config: Config, step: Steps) -> list[np.ndarray] | None:
    """Masks [H,W] uint8 of the training views for the start, where a plain backdrop lets them be learned."""
    if not backdrop(scene, config.train.background).plain:
        return None
    text = "learning where the object ends"
    with step("outlines", text):
        masks = learned_outlines(scene, config.seed, step.should_stop, step.share("outlines", text))
    if masks is None:
        step.progress(Event("outlines", "what splats cover there is no object: the start goes without outlines"))
    return masks


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
                checkpoint_path=out / outputs.CHECKPOINT,
                resume=resume,
                deadline=deadline,
                device=device.torch,
                pace=budget,
            )

    def run(self, before_surface: bool = False) -> TrainResult:
        """The branches after all stages, or with `before_surface` after those that the surface is made from."""
        with self._step("train", self._text):
            trained = self._training.run(finish=not before_surface)
        self._text = "training goes on"
        with self._step("export", "writing the splats"):
            models = Models(trained.surfels, trained.volumes, trained.light)
            outputs.write_models(self._out, models, self._scene, self._output)
        return trained
