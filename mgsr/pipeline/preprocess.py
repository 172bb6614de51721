"""Preprocessing of a run: the scene, its exposures, and where splats begin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from mgsr.budget.budget import TimeBudget
from mgsr.config import Config, DataConfig, Exposure, object_box
from mgsr.data.exposure import evened
from mgsr.data.masks import with_masks
from mgsr.data.object_scene import with_object
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import ConfigError
from mgsr.export.far_origin import origin_notes
from mgsr.pipeline import result_files
from mgsr.pipeline.object_files import clear_object, ground_of, require_place_for_masks, write_object
from mgsr.pipeline.progress import Event
from mgsr.pipeline.run_metadata import scene_line
from mgsr.pipeline.steps import Steps
from mgsr.pipeline.time_budget import most_points, searches_object
from mgsr.segmentation.object_masks import NoObject, find_object
from mgsr.shading.lighting import Lighting, lit_scene
from mgsr.start.starting_points import StartingPoints, starting_points
from mgsr.training.exposure import find_exposures
from mgsr.training.outlines import learned_outlines

LATER = ("exposure", "object", "object_box")  # settings of DataConfig that take effect after the reading


def take_scene(given: Path | Scene, out: Path, config: Config, step: Steps) -> Scene:
    """Return the scene, loaded if a path is given; report it, and remove an earlier run's reports from `out`."""
    if isinstance(given, Scene):
        scene = given
        result_files.clear_reports(out)
    else:
        with step("load", f"reading {given}"):
            scene = load_scene(given, config.data, progress=lambda done, total: step.progress(_loading(done, total)))
            result_files.clear_reports(out)
    for text in (scene_line(scene), *scene.notes, *origin_notes(scene.user_from_scene, config.output.scale)):
        step.progress(Event("load", text))
    return scene


def as_read(scene: Scene, config: Config) -> Config:
    """Return the settings, with the reading settings of an already loaded scene.

    Settings that work after the reading (LATER) are the caller's own unless they are left at their defaults. Raises
    ConfigError where the caller's other settings differ from the scene's.
    """
    chosen = {}
    for item in fields(DataConfig):
        asked, read = getattr(config.data, item.name), getattr(scene.read_with, item.name)
        if asked == item.default:
            chosen[item.name] = read
        elif asked == read or item.name in LATER:
            chosen[item.name] = asked
        else:
            raise ConfigError(
                f"data.{item.name}: {scene.name} is loaded with {read}, got {asked}; pass the setting to load_scene, "
                "or pass the scene's path in place of the scene"
            )
    return replace(config, data=DataConfig(**chosen))


def _loading(done: int, total: int) -> Event:
    return Event("load", f"read {done} of {total} photographs", done=done / total)


def preprocess(
    scene: Scene, config: Config, out: Path, step: Steps, budget: TimeBudget | None = None
) -> tuple[Scene, StartingPoints]:
    """Preprocess a scene: even its exposures, find its object and its light, and choose the starting points.

    Returns the scene and its starting points. The scene has its photographs at a common exposure, masks where an object
    is requested and found, and a flash's irradiance where there is one. The findings are written to `out`.
    """
    searched = searches_object(scene, config)
    if searched:
        require_place_for_masks(out)
    masks = _learn_masks(scene, config, step)

    def points(of: Scene, during: str, text: str) -> StartingPoints:
        count, progress = most_points(config, budget), step.share(during, text)
        return starting_points(with_masks(of, masks), count, config.seed, progress, config.train.background)

    result_files.clear_findings(out)
    clear_object(out)
    with step("start", "choosing starting points"):
        start = points(scene, "start", "choosing starting points")
    if config.data.exposure is not Exposure.KEEP:
        scene, start = _at_one_exposure(scene, start, config, out, step, None if searched else points)
    if searched:
        scene, start = _object_alone(scene, start, config, out, step, points)
    return _as_lit(scene, start.lighting, config, out, step), start


def _at_one_exposure(
    scene: Scene,
    start: StartingPoints,
    config: Config,
    out: Path,
    step: Steps,
    points: Callable[[Scene, str, str], StartingPoints] | None,
) -> tuple[Scene, StartingPoints]:
    """Bring the photographs to a common exposure, and choose the starting points again.

    Where exposures agree, both stay unchanged.

    points: chooses the starting points during a step; None leaves them as they are.
    """
    with step("exposures", "comparing the photographs' exposures"):
        exposures = find_exposures(scene, start, config.seed, step.should_stop)
        if exposures is None:
            return scene, start
        scene = evened(scene, exposures)
        result_files.write_exposures(out, scene, exposures)
        text = (
            f"exposures differ by a factor of up to {exposures.largest_difference:.2f}; all photographs are brought "
            "to a common exposure"
        )
        step.progress(Event("exposures", text))
        return scene, start if points is None else points(scene, "exposures", "choosing starting points again")


def _object_alone(
    scene: Scene,
    start: StartingPoints,
    config: Config,
    out: Path,
    step: Steps,
    points: Callable[[Scene, str, str], StartingPoints],
) -> tuple[Scene, StartingPoints]:
    """Return the scene with masks of its object, and starting points on the object.

    Without an object, return the whole scene with a note.

    points: chooses the starting points during a step.
    """
    text, anew = "looking for the object", "choosing starting points again"
    box = object_box(config.data.object_box)
    if box is not None:
        box = scene.user_from_scene.to_scene(box)
    with step("object", text):
        found = find_object(scene, start, config.seed, box, step.should_stop, step.share("object", text))
        if isinstance(found, NoObject):
            note = f"everything in view is reconstructed, because no single object was found: {found.reason}"
            step.progress(Event("object", note))
            scene = replace(scene, notes=(*scene.notes, note))
            return scene, start if scene.exposures is None else points(scene, "object", anew)
        write_object(out, scene, found)
        known = len(scene.notes)
        scene = with_object(scene, found.train, found.test, ground_of(scene, found))
        note = f"the object was found; the agreement of its masks is {found.agreement.mean():.0%}"
        for each in (note, *scene.notes[known:]):
            step.progress(Event("object", each))
        scene = replace(scene, notes=(*scene.notes, note))
        return scene, points(scene, "object", anew)


def _as_lit(scene: Scene, lighting: Lighting | None, config: Config, out: Path, step: Steps) -> Scene:
    """Add a flash's irradiance to the scene's views, where a flash was found and training shall know of it."""
    if lighting is None or not config.train.flash:
        return scene
    with step("start", "computing the irradiance of the flash in each view"):
        result_files.write_lighting(out, lighting, scene)
        return lit_scene(scene, lighting)


def _learn_masks(scene: Scene, config: Config, step: Steps) -> list[np.ndarray] | None:
    """Learn masks [H,W] uint8 of the training views for the start, where a plain backdrop lets them be learned."""
    if not scene.backdrop(config.train.background).plain:
        return None
    text = "learning the object's silhouettes"
    with step("outlines", text):
        masks = learned_outlines(scene, config.seed, step.should_stop, step.share("outlines", text))
    if masks is None:
        step.progress(Event("outlines", "the learned silhouettes show no object, so the start does without them"))
    return masks
