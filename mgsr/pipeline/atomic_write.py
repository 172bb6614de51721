"""Atomic writes: a result is written beside its place and then moved there, so that no part of one ever appears."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mgsr.errors import ConfigError


@contextmanager
def atomic_write(target: Path) -> Iterator[Path]:
    """Yield a path beside `target` with the same endings, for a file or a folder to be written atomically.

    If the block succeeds, the path replaces `target`: a file replaces a file, a folder a folder. If it fails, the path
    is removed. Where `target` is a link, the link's destination is replaced.

    Raises ConfigError if a file would replace a folder or a folder a file, and for places that can't be replaced:
    devices, and folders that contain the current folder.
    """
    place = _place(target)
    place.parent.mkdir(parents=True, exist_ok=True)
    partial = place.with_name(f".partial.{place.name}")
    _remove(partial)
    try:
        yield partial
        if not partial.is_dir():
            require_file_place(target)
        elif place.is_file():
            raise ConfigError(f"{target}: expected a folder to write, found a file; choose a new folder")
        elif place.is_dir():
            shutil.rmtree(place)
        os.replace(partial, place)
    finally:
        _remove(partial)


def require_file_place(target: Path) -> None:
    """Check that a file can be written at `target`, before the work rather than after it.

    Raises ConfigError where a folder is there.
    """
    if _place(target).is_dir():
        raise ConfigError(f"{target}: expected a file to write, found a folder; choose a file in it")


def _place(target: Path) -> Path:
    """Resolve links, `.` and `..` in `target`.

    Raises ConfigError for places that must not be replaced.
    """
    place = Path(os.path.realpath(target))
    if Path.cwd().is_relative_to(place):
        raise ConfigError(f"{target}: this folder is or contains the current folder; choose a new name in it")
    if place.exists() and not (place.is_file() or place.is_dir()):
        raise ConfigError(f"{target}: this is neither a file nor a folder; choose a new file")
    return place


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
