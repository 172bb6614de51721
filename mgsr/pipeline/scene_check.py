"""The inspection of a capture as a step of a run, and the removal of photographs with contradictory poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

from mgsr.config import Config, Flawed
from mgsr.data.scene import Scene
from mgsr.errors import SceneError
from mgsr.inspection.findings import Code, Inspection, shown
from mgsr.inspection.inspect import inspect_scene, photo_names
from mgsr.pipeline.progress import Event
from mgsr.pipeline.steps import Steps

# Findings that the notes of the reading already contain.
_NOTED = (Code.BLURRED, Code.FEW_PHOTOGRAPHS, Code.INEXACT_MASKS)


@dataclass(frozen=True)
class CheckedScene:
    """A scene and its inspection; the inspection is None if the settings turn it off."""

    scene: Scene
    inspection: Inspection | None


def check_scene(scene: Scene, config: Config, step: Steps) -> CheckedScene:
    """Inspect a scene, report the findings, and leave out contradictory photographs where `data.flawed` is drop.

    Raises Cancelled if a stop is requested, and SceneError if too few photographs are left.
    """
    if not config.data.check and config.data.flawed is Flawed.KEEP:
        return CheckedScene(scene, None)
    text = "checking photographs and cameras"
    with step("check", text):
        inspection = inspect_scene(scene, step.share("check", text), config.expert.inspection)
        for finding in inspection.findings:
            if finding.code not in _NOTED:
                step.progress(Event("check", finding.line))
        step.progress(Event("check", summary(inspection), inspection=inspection, scene=scene))
    if config.data.flawed is Flawed.DROP:
        kept = without_contradictory(scene, inspection)
        for note in kept.notes[len(scene.notes) :]:
            step.progress(Event("check", note))
        scene = kept
    return CheckedScene(scene, inspection)


def without_flawed(scene: Scene, config: Config) -> Scene:
    """Drop the photographs whose poses contradict what they show, if the settings say `Flawed.DROP`.

    Raises SceneError if too few photographs are left.
    """
    if config.data.flawed is not Flawed.DROP:
        return scene
    return without_contradictory(scene, inspect_scene(scene, options=config.expert.inspection))


def without_contradictory(scene: Scene, inspection: Inspection) -> Scene:
    """Drop the photographs whose poses contradict the others, and add a note about them to the scene.

    Raises SceneError if fewer than two training photographs are left.
    """
    names = photo_names(scene)
    odd = inspection.contradictory
    if not odd:
        return scene
    kept = [name not in odd for name in names]
    train = list(compress(scene.train, kept))
    test = list(compress(scene.test, kept[len(scene.train) :]))
    if len(train) < 2:
        raise SceneError(
            f"{scene.name}: expected at least 2 training photographs whose poses do not contradict what they show, got "
            f"{len(train)}; find the cameras again with `mgsr poses`"
        )
    note = f"the poses of {len(odd)} of {len(names)} photographs contradict what they show ({shown(odd)}): left out"
    return replace(scene, train=train, test=test, notes=(*scene.notes, note))


def summary(inspection: Inspection) -> str:
    """Return the number of findings of each severity, in one line."""
    counts = _counted([finding.severity for finding in inspection.findings])
    photographs = f"{len(inspection.photographs)} photographs checked in {inspection.seconds:.1f} s"
    return f"{photographs}: {counts or 'nothing was found'}"


def _counted(severities: Sequence[str]) -> str:
    kinds = list(dict.fromkeys(severities))
    return ", ".join(f"{severities.count(kind)} {kind}" + ("s" if severities.count(kind) > 1 else "") for kind in kinds)
