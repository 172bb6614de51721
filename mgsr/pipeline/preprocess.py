"""Preprocessing of a run: reading the scene, its exposures, its object, its light, and its starting points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from mgsr.budget.budget import TimeBudget
from mgsr.config import Config, DataConfig, ExpertConfig, Exposure, object_box
from mgsr.config.expert import DataOptions
from mgsr.data.camera_search import CameraSearch
from mgsr.data.exposure import with_exposures
from mgsr.data.find_cameras import with_cameras
from mgsr.data.find_scene import FoundScene
from mgsr.data.found_cameras import CameraFolder
from mgsr.data.mask_error import with_mask_error
from mgsr.data.masks import with_masks
from mgsr.data.object_place import ObjectPlace
from mgsr.data.object_scene import with_object
from mgsr.data.readers import find_capture, load_capture, load_scene
from mgsr.data.scene import Scene, some_of
from mgsr.errors import ConfigError
from mgsr.export.far_origin import origin_notes
from mgsr.pipeline import result_files
from mgsr.pipeline.object_files import (
    clear_object,
    ground_of,
    require_place_for_masks,
    with_found_object,
    write_background_color,
    write_object,
)
from mgsr.pipeline.progress import Event
from mgsr.pipeline.result_paths import CAMERAS, OBJECT
from mgsr.pipeline.run_metadata import scene_line
from mgsr.pipeline.scene_check import CheckedScene, check_scene, without_flawed
from mgsr.pipeline.steps import Steps
from mgsr.pipeline.time_budget import affordable_options, most_points, searches_object
from mgsr.segmentation.object_masks import NoObject, find_object
from mgsr.shading.lighting import Lighting, add_irradiance
from mgsr.start.bundle_adjustment import adjust_cameras
from mgsr.start.points import StartingPoints
from mgsr.start.scene_depths import DepthMaps, scene_depths
from mgsr.start.starting_points import starting_points
from mgsr.training.background import train_background
from mgsr.training.exposure import find_exposures
from mgsr.training.learned_masks import learn_masks

# Settings of DataConfig that take effect after the reading.
LATER = ("exposure", "adjust_cameras", "object", "object_box", "check")


def take_scene(
    given: Path | Scene, out: Path | None, config: Config, step: Steps, resume: bool = False
) -> CheckedScene:
    """Load the scene if a path is given, and inspect it; remove an earlier run's reports from `out`, if given.

    If the photographs have no cameras, the function first searches for them and leaves them in `out`. resume: use
    cameras that are already there, and continue an interrupted search.

    Raises SceneError if the scene can't be used.
    """
    if isinstance(given, Scene):
        scene = given
    else:
        with step("load", f"reading {given}"):
            found = find_capture(given, config.data)
        if found.kind is None:
            found = _with_cameras(found, out, config, step, resume)
        elif out is not None and not found.folder.root.resolve().is_relative_to((out / CAMERAS).resolve()):
            CameraFolder(out / CAMERAS).clear()  # an earlier run's cameras may belong to other photographs
        with step.clock.step("load"):
            scene = load_capture(found, config.data, partial(_tell_loading, step), config.expert.data)
    if out is not None:
        result_files.clear_reports(out)
    scene = with_mask_error(scene)
    for text in (scene_line(scene), *scene.notes, *origin_notes(scene.user_from_scene, config.output.scale)):
        step.progress(Event("load", text))
    return check_scene(scene, config, step)


def _with_cameras(found: FoundScene, out: Path | None, config: Config, step: Steps, resume: bool) -> FoundScene:
    """Search for the cameras of photographs, as a step of the run."""
    text = "finding the cameras"
    with step("cameras", f"{found.name} has no cameras: {text}"):
        search = CameraSearch(
            folder=None if out is None else out / CAMERAS,
            resume=resume,
            seed=config.seed,
            say=lambda line: step.progress(Event("cameras", line)),
            tell=step.share("cameras", text),
        )
        return with_cameras(found, config.data, search, config.expert.data)


def _tell_loading(step: Steps, done: int, total: int) -> None:
    step.progress(Event("load", f"read {done} of {total} photographs", done=done / total))


def load_again(path: Path, out: Path, config: Config) -> Scene:
    """Load the scene of the results in `out` as the run did; cameras that it found or adjusted are read from `out`.

    Raises SceneError if the scene can't be used, and if cameras that the run found are missing. Raises MgsrError if
    adjusted cameras do not fit the photographs.
    """
    search = CameraSearch(folder=out / CAMERAS, known_only=True, seed=config.seed)
    scene = load_scene(path, config.data, search=search, options=config.expert.data)
    return result_files.with_known_cameras(out, without_flawed(with_mask_error(scene), config))


def as_read(scene: Scene, config: Config) -> Config:
    """Return the settings, with the reading settings of an already loaded scene.

    Settings that take effect after the reading (LATER) come from the caller unless they have their defaults. Raises
    ConfigError if other settings of the caller differ from the scene's.
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
    options = scene.options if config.expert.data == DataOptions() else config.expert.data
    if options != scene.options:
        raise ConfigError(
            f"expert.data: {scene.name} is loaded with other options; pass the options to load_scene, or pass the path "
            "in place of the scene"
        )
    return replace(config, data=DataConfig(**chosen), expert=replace(config.expert, data=options))


def preprocess(
    scene: Scene,
    config: Config,
    out: Path,
    step: Steps,
    budget: TimeBudget | None = None,
    reuse_object: bool = False,
) -> tuple[Scene, StartingPoints]:
    """Preprocess a scene: adjust its cameras, equalise its exposures, find its object, its light and starting points.

    Returns the scene and its starting points. The scene's photographs have a common exposure. The scene has masks if
    an object is requested and found, and a flash's irradiance if there is a flash. The findings are written to `out`.

    reuse_object: take an object's masks from `out`, if they are there. Raises MgsrError if they do not fit the
    photographs.
    """
    searched = searches_object(scene, config)
    kept = searched and reuse_object and (out / OBJECT).is_file()
    if kept:
        scene, searched = _with_kept_object(out, result_files.with_known_cameras(out, scene), step), False
    if searched:
        require_place_for_masks(out)
    masks = _learn_masks(scene, config, step)

    expert = affordable_options(config, budget)
    result_files.clear_findings(out, with_cameras=not kept)
    if not kept:
        clear_object(out)
    depths: DepthMaps | None = None
    if not with_masks(scene, masks).masked:
        scene, depths = _with_depths(scene, config, out, step, expert)

    def points(of: Scene, during: str, text: str) -> StartingPoints:
        count, progress = most_points(config, budget), step.share(during, text)
        masked, background = with_masks(of, masks), config.train.background
        return starting_points(masked, count, config.seed, progress, background, expert, depths)

    with step("start", "choosing starting points"):
        start = points(scene, "start", "choosing starting points")
    if config.data.exposure is not Exposure.KEEP:
        scene, start = _at_one_exposure(scene, start, config, out, step, None if searched else points)
    if searched:
        scene, start = _object_alone(scene, start, config, out, step, points)
    return _with_irradiance(scene, start.lighting, config, out, step), start


def _with_kept_object(out: Path, scene: Scene, step: Steps) -> Scene:
    """Add the masks of the object that an earlier run left in `out`. Raises MgsrError if they do not fit."""
    scene = with_found_object(out, scene)
    note = "the object's masks are those that an earlier run found"
    step.progress(Event("object", note, scene=scene))
    return replace(scene, notes=(*scene.notes, note))


def _with_depths(scene: Scene, config: Config, out: Path, step: Steps, expert: ExpertConfig) -> tuple[Scene, DepthMaps]:
    """Find the depth maps of everything in view, which do not depend on the exposures, and adjust the cameras to them.

    Returns the scene, with adjusted cameras if the photographs agree better with them, and the depth maps.
    """
    text = "measuring the depths of everything in view"
    with step("start", text):
        progress = step.share("start", text)
        depths = scene_depths(scene.train, config.seed, progress, expert.start.stereo, expert.stereo)
    if not config.data.adjust_cameras:
        return scene, depths
    text = "adjusting the cameras"
    with step("start", text):
        progress = step.share("start", text)
        adjusted = adjust_cameras(scene.train, scene.test, depths, progress, expert.start.bundle)
        if adjusted is None:
            return scene, depths
        scene = scene.with_cameras(adjusted.train, adjusted.test, adjusted.shift)
        result_files.write_cameras(out, scene)
        text = (
            f"the cameras were adjusted by {adjusted.shift:.2f} pixels in the median, which removes "
            f"{adjusted.gain:.0%} of the deviation between photographs"
        )
        step.progress(Event("start", text))
        return scene, depths.seen_from(some_of(adjusted.train))


def _at_one_exposure(
    scene: Scene,
    start: StartingPoints,
    config: Config,
    out: Path,
    step: Steps,
    points: Callable[[Scene, str, str], StartingPoints] | None,
) -> tuple[Scene, StartingPoints]:
    """Bring the photographs to a common exposure, and choose the starting points again.

    If the exposures agree, both stay unchanged. points: chooses the starting points during a step; None: keep them.
    """
    with step("exposures", "comparing the photographs' exposures"):
        exposures = find_exposures(scene, start, config.seed, step.should_stop, config.expert)
        if exposures is None:
            return scene, start
        scene = with_exposures(scene, exposures)
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
    """Find the object, and return the scene with its masks and starting points on it.

    If no object is found, return the whole scene with a note. points: chooses the starting points during a step.
    """
    place, options = _object_place(scene, config), config.expert.segmentation
    box = None if place is None else scene.user_from_scene.to_scene(place.box)
    ground = None
    if place is not None and place.ground is not None:
        ground = scene.user_from_scene.inverse.plane_to_user(place.ground)
    text = "looking for the object" + (" in the given box" if place is not None else "")
    with step("object", text):
        progress = step.share("object", text)
        found = find_object(scene, start, config.seed, box, ground, step.should_stop, progress, options)
        if isinstance(found, NoObject):
            note = f"everything in view is reconstructed, because no single object was found: {found.reason}"
        else:
            note = f"the object was found; the agreement of its masks is {found.agreement.mean():.0%}"
            write_object(out, scene, found)
    whole, scene = scene, replace(scene, notes=(*scene.notes, note))
    if isinstance(found, NoObject):
        step.progress(Event("object", note))
        if scene.exposures is None:
            return scene, start
    else:
        scene = with_object(scene, found.train, found.test, ground_of(whole, found))
        step.progress(Event("object", note, scene=scene))
        text = "training what lies around the object"
        with step("background", text):
            report = step.share("background", text)
            background, color = train_background(whole, found.train, start, config, step.should_stop, report)
            result_files.write_background(out, background, whole, config.output)
            write_background_color(out, color)
        for each in scene.notes[len(whole.notes) + 1 :]:
            step.progress(Event("object", each))
    with step("object", "choosing starting points anew"):
        return scene, points(scene, "object", "choosing starting points anew")


def _object_place(scene: Scene, config: Config) -> ObjectPlace | None:
    """Return the object's place from the settings, or else from the capture; None if neither gives one."""
    box = object_box(config.data.object_box)
    return scene.object_place if box is None else ObjectPlace(box)


def _with_irradiance(scene: Scene, lighting: Lighting | None, config: Config, out: Path, step: Steps) -> Scene:
    """Add a flash's irradiance to the scene's views, if a flash was found and `train.flash` is on."""
    if lighting is None or not config.train.flash:
        return scene
    with step("start", "computing the irradiance of the flash in each view"):
        result_files.write_lighting(out, lighting, scene)
        return add_irradiance(scene, lighting)


def _learn_masks(scene: Scene, config: Config, step: Steps) -> list[np.ndarray] | None:
    """Learn masks [H,W] uint8 of the training views for the start; None without a plain backdrop."""
    if not scene.backdrop(config.train.background).plain:
        return None
    text = "learning the object's silhouettes"
    with step("learned_masks", text):
        progress = step.share("learned_masks", text)
        masks = learn_masks(scene, config.seed, step.should_stop, progress, config.expert)
    if masks is None:
        step.progress(Event("learned_masks", "the learned silhouettes show no object, so the start does without them"))
    return masks
