"""Writing of scenes as new folders for other programs."""

from __future__ import annotations

import math
from pathlib import Path

from mgsr.data.archive import ARCHIVE_SUFFIXES
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import ConfigError
from mgsr.export.convert import FILE_SUFFIXES
from mgsr.export.gltf import UpAxis
from mgsr.export.scenes import write_scene
from mgsr.pipeline.atomic_write import atomic_write
from mgsr.pipeline.run_metadata import scene_line


def require_new_folder(target: Path) -> None:
    """Check, before any work, that `target` is new or an empty folder. Raises ConfigError otherwise."""
    if target.exists() and (target.is_file() or any(target.iterdir())):
        raise ConfigError(f"{target}: the folder is not empty; choose a new folder for the scene")


def write_scene_folder(target: Path, scene: Scene, scale: float) -> None:
    """Write the scene at `target` atomically (see `write_scene`). Raises the errors of `require_new_folder`."""
    require_new_folder(target)
    with atomic_write(target) as folder:
        folder.mkdir()
        write_scene(folder, scene, scale)


def convert_scene(source: Path, target: Path, scale: float, up: UpAxis | None) -> str:
    """Write the scene at `source` as a new folder, with all lengths times `scale`; return a one-line summary.

    up: must be None, because a scene keeps its frame. Raises ConfigError for invalid arguments, and SceneError.
    """
    if target.name.lower().endswith((*FILE_SUFFIXES, *ARCHIVE_SUFFIXES)):
        raise ConfigError(f"{target}: {source} is a scene, which is written as a folder; choose a new folder")
    if up is not None:
        raise ConfigError(f"--up {up}: {source} is a scene, which keeps its frame; remove --up")
    require_new_folder(target)
    if not (math.isfinite(scale) and scale > 0):
        raise ConfigError(f"--scale {scale:g}: expected a number above 0")
    scene = load_scene(source)
    write_scene_folder(target, scene, scale)
    return scene_line(scene)
