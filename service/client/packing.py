"""Packing of a scene into one file for an upload."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.contract.errors import SetupError


@contextmanager
def packed(scene: Path) -> Iterator[Path]:
    """Yield the scene as one file: a file itself, or a zip of a folder's files, without hidden ones.

    Raises SetupError if there is no scene.
    """
    if scene.is_file():
        yield scene
        return
    if not scene.is_dir():
        raise SetupError(f"{scene}: expected a folder or an archive of photographs, or a video, but it does not exist")
    with tempfile.NamedTemporaryFile(suffix=".zip") as made:
        with zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as target:  # photographs are compressed already
            for path in sorted(scene.rglob("*")):
                name = path.relative_to(scene)
                if path.is_file() and not any(part.startswith(".") for part in name.parts):
                    target.write(path, name.as_posix())
        made.flush()
        yield Path(made.name)
