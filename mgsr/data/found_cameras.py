"""The folder of found cameras: a COLMAP model, the frames of a video, and the state of an unfinished search."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from mgsr.data.camera_search import SEARCH_STATE
from mgsr.data.capture import Capture
from mgsr.data.formats.colmap import read_model
from mgsr.data.photo_files import SceneFolder
from mgsr.errors import SceneError

# The names in the folder. A model beside the photographs is a scene in COLMAP's form.
MODEL = "sparse/0"
IMAGES = "images"
DATABASE = "database.db"

# Least seconds between two copies of the database, and the least multiple of a copy's time.
_KEEP_EVERY = 20.0
_KEEP_SHARE = 20.0

_HEAD = 1 << 16


@dataclass(frozen=True)
class SearchState:
    """The state of a search for cameras.

    photographs: the key of the photographs (see `key_of`).
    settings: the settings that affect the search.
    finished: whether the model is complete.
    notes: notes for the user.
    frames: the number of frames chosen from videos, 0 before the choice.
    """

    photographs: str
    settings: str
    finished: bool = False
    notes: tuple[str, ...] = ()
    frames: int = 0


@dataclass(frozen=True)
class CameraFolder:
    """A folder of found cameras."""

    path: Path

    @property
    def images(self) -> Path:
        """Return the folder of a video's frames."""
        return self.path / IMAGES

    @property
    def database(self) -> Path:
        """Return the path of COLMAP's database, for an unfinished search."""
        return self.path / DATABASE

    def state(self, photographs: str, settings: str | None) -> SearchState | None:
        """Return the state of the search that this folder holds.

        photographs, settings: the photographs and settings of the search; settings None accepts any. Returns None if
        there is no such search.
        """
        try:
            content = json.loads((self.path / SEARCH_STATE).read_text(encoding="utf-8"))
            state = SearchState(**content | {"notes": tuple(content["notes"])})
        except (OSError, ValueError, TypeError, LookupError):
            return None
        model_is_there = not state.finished or (self.path / MODEL / "images.bin").is_file()
        same = state.photographs == photographs and settings in (None, state.settings)
        return state if same and model_is_there else None

    def write_state(self, state: SearchState) -> None:
        """Write the state atomically."""
        self.path.mkdir(parents=True, exist_ok=True)
        partial = self.path / f".partial.{SEARCH_STATE}"
        partial.write_text(json.dumps(asdict(state)), encoding="utf-8")
        os.replace(partial, self.path / SEARCH_STATE)

    def clear(self) -> None:
        """Remove the search's files, and the folder if nothing else is in it."""
        for name in (DATABASE, SEARCH_STATE, f".partial.{SEARCH_STATE}", f".partial.{DATABASE}"):
            (self.path / name).unlink(missing_ok=True)
        for name in (IMAGES, MODEL.split("/")[0]):
            shutil.rmtree(self.path / name, ignore_errors=True)
        if self.path.is_dir() and not any(self.path.iterdir()):
            self.path.rmdir()

    def finish(self, model: Any, state: SearchState) -> None:
        """Write a pycolmap.Reconstruction and then the state, and remove the database."""
        partial = self.path / ".partial.sparse"
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        model.write(str(partial))
        target = self.path / MODEL
        shutil.rmtree(target, ignore_errors=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(partial, target)
        self.write_state(state)
        self.database.unlink(missing_ok=True)

    def read(self, photos: SceneFolder, notes: Sequence[str]) -> Capture:
        """Read the model, whose photographs lie in another folder. Raises SceneError if it is damaged."""
        capture = read_model(self.path / MODEL, photos)
        return replace(capture, notes=(*notes, *capture.notes))


class DatabaseKeeper:
    """A keeper that copies a search's database at intervals to a folder that outlives the process."""

    def __init__(self, database: Path, copy: Path) -> None:
        self._database, self._copy = database, copy
        self._due = time.monotonic() + _KEEP_EVERY

    def __call__(self) -> None:
        """Copy the database if a copy is due; no one may have it open."""
        if time.monotonic() >= self._due:
            self.keep()

    def keep(self) -> None:
        """Copy the database."""
        started_at = time.monotonic()
        if not self._database.exists():
            return
        partial = self._copy.with_name(f".partial.{self._copy.name}")
        shutil.copyfile(self._database, partial)
        os.replace(partial, self._copy)
        now = time.monotonic()
        self._due = now + max(_KEEP_EVERY, _KEEP_SHARE * (now - started_at))


def key_of(files: Sequence[Path], folder: Path) -> str:
    """Return a key of photographs or videos, from their names, sizes and first bytes."""
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as opened:
            head = opened.read(_HEAD)
        digest.update(f"{file.relative_to(folder).as_posix()} {file.stat().st_size} ".encode())
        digest.update(hashlib.sha256(head).digest())
    return digest.hexdigest()


def no_cameras_in(folder: Path, given: Path) -> SceneError:
    """Return the error for photographs whose cameras are missing from a folder of results."""
    return SceneError(
        f"{given}: photographs without cameras, and {folder} has no cameras of them; finish `mgsr run` with the same "
        "photographs first"
    )
