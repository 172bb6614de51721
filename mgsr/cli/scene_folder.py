"""Scenes as new folders for other programs."""

from __future__ import annotations

from pathlib import Path

from mgsr.cli.whole import whole
from mgsr.data.scene import Scene
from mgsr.errors import ConfigError
from mgsr.export.scenes import write_scene


def require_new_folder(target: Path) -> None:
    """Check that nothing is at `target`, before the work rather than after it.

    Raises ConfigError where something is.
    """
    if target.exists() and (target.is_file() or any(target.iterdir())):
        raise ConfigError(f"{target}: is not empty; name a new folder for the scene")


def write_scene_folder(target: Path, scene: Scene, scale: float) -> None:
    """Write the scene to `target` (see `write_scene`), whole or not at all.

    Raises as `require_new_folder`.
    """
    require_new_folder(target)
    with whole(target) as folder:
        folder.mkdir()
        write_scene(folder, scene, scale)
