"""Scenes as new folders for other programs."""

from __future__ import annotations

from pathlib import Path

from mgsr.data.scene import Scene
from mgsr.errors import ConfigError
from mgsr.export.scenes import write_scene
from mgsr.pipeline.atomic_write import atomic_write


def require_new_folder(target: Path) -> None:
    """Raises ConfigError where something is at `target` already: before the work, not after."""
    if target.exists() and (target.is_file() or any(target.iterdir())):
        raise ConfigError(f"{target}: is not empty; name a new folder for the scene")


def write_scene_folder(target: Path, scene: Scene, scale: float) -> None:
    """The scene at `target` (see `write_scene`), whole or not at all. Raises as `require_new_folder`."""
    require_new_folder(target)
    with atomic_write(target) as folder:
        folder.mkdir()
        write_scene(folder, scene, scale)
