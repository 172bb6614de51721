"""The files of a found object: its masks, and where it lies."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mgsr.data.backdrop import WHITE, Color
from mgsr.data.images import read_mask
from mgsr.data.object_scene import with_object
from mgsr.data.scene import Scene, View
from mgsr.errors import ConfigError, MgsrError
from mgsr.export.scenes import write_image
from mgsr.pipeline.atomic_write import atomic_write
from mgsr.pipeline.result_paths import BACKGROUND, MASKS, OBJECT
from mgsr.segmentation.object_masks import FoundObject


def write_object(out: Path, scene: Scene, found: FoundObject) -> None:
    """Write masks/NAME.png of all views, and object.json.

    The masks have the form in which MGSR reads masks beside photographs, so users can correct them and run again.
    object.json has the corners of the object's box and its support plane, both in the user's frame. For each training
    view, by name, it has the agreement of the view's mask with the others. `write_background_color` adds a colour.
    """
    with atomic_write(out / MASKS) as folder:
        for (_, name), mask in zip(_names(scene), [*found.train, *found.test], strict=True):
            write_image(folder / name, mask)
    low, high = scene.user_from_scene.to_user(found.box).tolist()
    agreement = {view.name: round(float(value), 4) for view, value in zip(scene.train, found.agreement, strict=True)}
    ground = ground_of(scene, found)
    plane = None if ground is None else ground.tolist()
    with atomic_write(out / OBJECT) as path:
        path.write_text(json.dumps({"box": [*low, *high], "ground": plane, "agreement": agreement}, indent=1))


def write_background_color(out: Path, color: Color) -> None:
    """Add the colour behind the background's Gaussians, sRGB 0..1, to object.json."""
    found = json.loads((out / OBJECT).read_text())
    with atomic_write(out / OBJECT) as path:
        path.write_text(json.dumps({**found, "background_color": list(color)}, indent=1))


def read_background_color(out: Path) -> Color:
    """Return the colour behind the background's Gaussians, sRGB 0..1; white where no object.json names it."""
    if not (out / OBJECT).is_file():
        return WHITE
    red, green, blue = json.loads((out / OBJECT).read_text()).get("background_color", WHITE)
    return (red, green, blue)


def ground_of(scene: Scene, found: FoundObject) -> np.ndarray | None:
    """Return the plane [4] on which the object stands, in the user's frame, None without one (see `Scene.ground`)."""
    return None if found.plane is None else scene.user_from_scene.plane_to_user(found.plane.coefficients)


def require_place_for_masks(out: Path) -> None:
    """Check, before any work, that `out` has no folder of masks from elsewhere. Raises ConfigError if it has one."""
    if (out / MASKS).exists() and not (out / OBJECT).is_file():
        raise ConfigError(
            f"{out / MASKS}: this folder exists and does not belong to a run of MGSR; choose another folder for the "
            "results"
        )


def clear_object(out: Path) -> None:
    """Remove an earlier run's files of an object; masks from elsewhere stay."""
    (out / BACKGROUND).unlink(missing_ok=True)
    if (out / OBJECT).is_file():
        shutil.rmtree(out / MASKS, ignore_errors=True)
        (out / OBJECT).unlink()


def with_found_object(out: Path, scene: Scene) -> Scene:
    """Add the masks that the run in `out` found, in the object's frame; without such masks, return the scene unchanged.

    Raises MgsrError if a mask is missing or has another size, and SceneError for files that are not images.
    """
    if not (out / OBJECT).is_file():
        return scene
    masks = [_read(out / MASKS / name, view, out) for view, name in _names(scene)]
    plane = json.loads((out / OBJECT).read_text()).get("ground")
    ground = None if plane is None else np.array(plane)
    return with_object(scene, masks[: len(scene.train)], masks[len(scene.train) :], ground)


def mask_agreement(out: Path) -> dict[str, float]:
    """Return each mask's agreement with the others, 0..1, by the training view's name; empty without an object."""
    if not (out / OBJECT).is_file():
        return {}
    return dict(json.loads((out / OBJECT).read_text())["agreement"])


def _names(scene: Scene) -> Iterator[tuple[View, str]]:
    """Yield each view, the training views first, and the name of its mask's file.

    A test view with the name of a training view has its mask in a separate folder.
    """
    taken = {view.name for view in scene.train}
    for view in scene.train:
        yield view, f"{view.name}.png"
    for view in scene.test:
        yield view, f"test/{view.name}.png" if view.name in taken else f"{view.name}.png"


def _read(path: Path, view: View, out: Path) -> np.ndarray:
    """Read a mask [H,W] uint8 of the view's size. Raises MgsrError where it is missing or of another size."""
    mask = read_mask(path, path.name) if path.is_file() else None
    if mask is None or mask.shape != view.image.shape[:2]:
        height, width = view.image.shape[:2]
        came = "none" if mask is None else f"{mask.shape[1]}x{mask.shape[0]}"
        raise MgsrError(
            f"{path}: expected a mask of {width}x{height} pixels, got {came}; run `mgsr run SCENE -o {out}` again"
        )
    return mask
