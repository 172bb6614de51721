"""Estimates of the time and the memory that a run on a scene would take at each preset, on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from mgsr.budget.costs import iteration_cost, load_cost
from mgsr.budget.estimate import Estimate, Speed, estimate_run
from mgsr.budget.line import SettingsLine
from mgsr.config import PRESETS, Config
from mgsr.data.scene import Scene
from mgsr.pipeline.atomic_write import atomic_write
from mgsr.pipeline.device import Device, pick_device
from mgsr.pipeline.preprocess import take_scene
from mgsr.pipeline.progress import Event, EventCallback, ignore
from mgsr.pipeline.result_paths import ESTIMATE
from mgsr.pipeline.scene_check import CheckedScene
from mgsr.pipeline.steps import StepClock, Steps, StopCheck, never
from mgsr.pipeline.time_budget import cost_factors
from mgsr.start.points import StartingPoints, StartSource
from mgsr.training.probe import probe

_RADIUS = 0.5  # the radius, in the scene's frame, of the ball on which the timed splats lie


def estimate_presets(
    given: Path | Scene,
    config: Config,
    device: str = "auto",
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
) -> list[Estimate]:
    """Estimate the time and the memory of a run on a scene, or on the path of one, at each preset.

    config: the settings; those that differ from its preset's are kept for every preset. The photographs are read, and
    some iterations of training are timed. Raises the errors of `run_scene` before training.
    """
    chosen = pick_device(device)
    step = Steps(StepClock(), progress, should_stop)
    return _estimates(take_scene(given, None, config, step), config, chosen, step)


def write_estimate(
    path: Path,
    out: Path,
    config: Config,
    device: str = "auto",
    progress: EventCallback = ignore,
    should_stop: StopCheck = never,
) -> Path:
    """Write the estimate of each preset and the check of the photographs to `out`/estimate.json; return its path.

    Earlier reports in `out` are removed. Raises the errors of `estimate_presets`.
    """
    chosen = pick_device(device)
    step = Steps(StepClock(), progress, should_stop)
    checked = take_scene(path, out, config, step)
    estimates = _estimates(checked, config, chosen, step)
    inspection = None if checked.inspection is None else checked.inspection.to_json()
    content = {"device": str(chosen), "presets": [asdict(each) for each in estimates], "inspection": inspection}
    with atomic_write(out / ESTIMATE) as target:
        target.write_text(json.dumps(content, indent=1))
    return out / ESTIMATE


def estimate_line(estimate: Estimate) -> str:
    """Return an estimate in one line."""
    return f"{estimate.preset:9} up to about {_duration(estimate.seconds)} and {estimate.memory_mib / 1024:.1f} GiB"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _estimates(checked: CheckedScene, config: Config, device: Device, step: Steps) -> list[Estimate]:
    scene, factors = checked.scene, cost_factors(checked.scene, config)
    with step("plan", "timing an iteration of each stage"):
        probed = probe(scene, _ball(config), config, device.torch)
    reference = {name: iteration_cost(name, factors, probed.splats) for name in probed.seconds}
    training = sum(probed.seconds.values()) / sum(reference.values())
    before: dict[str, float] = {name: step.clock.steps[name] for name in ("load", "check") if name in step.clock.steps}
    rest = training if device is Device.CPU else before.get("load", load_cost(factors)) / load_cost(factors)
    line = SettingsLine(config)
    estimates = [
        estimate_run(preset, factors, line.at(float(place)), Speed(training, rest), before)
        for place, preset in enumerate(PRESETS)
    ]
    for each in estimates:
        step.progress(Event("plan", estimate_line(each)))
    return estimates


def _ball(config: Config) -> StartingPoints:
    """Return starting points on a ball. An iteration with them takes as long as with points on a surface."""
    rng = np.random.default_rng(config.seed)
    normals = rng.normal(size=(config.train.surfels.max_start, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors = np.full(normals.shape, 128, np.uint8)
    return StartingPoints(_RADIUS * normals, colors, StartSource.BALL, normals)
