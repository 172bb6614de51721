"""Find the cameras of a capture that has none: photographs, or a video, by structure from motion."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mgsr.config import DataConfig
from mgsr.config.expert import DataOptions, FrameOptions
from mgsr.data.archive import temporary_folder
from mgsr.data.camera_search import CameraSearch
from mgsr.data.capture import Capture, Format
from mgsr.data.find_scene import FoundScene
from mgsr.data.found_cameras import CameraFolder, DatabaseKeeper, SearchState, key_of, no_cameras_in
from mgsr.data.gather_photos import find_photos, gather
from mgsr.data.odd_files import videos_below
from mgsr.data.photo_files import SceneFolder
from mgsr.data.shared_lenses import PhotoFile, SharedLens, describe_lenses, share_lenses
from mgsr.data.structure_from_motion import SearchFolder, find_model, require_pycolmap
from mgsr.data.video_frames import write_frames
from mgsr.errors import Cancelled, ConfigError, SceneError

# The share of the search that choosing the frames of videos takes.
_FRAMES = 0.3


# The names of these kinds of input in reports.
PHOTOGRAPHS, VIDEO = "photographs", "video"

# The share of the remaining search that decoding the photographs takes.
_GATHERED = 0.1

_FOUND = "the cameras were found from the photographs, which came without any: lengths have no unit"


@dataclass(frozen=True)
class _Task:
    """A capture without cameras, its photographs or videos, and where its cameras go."""

    found: FoundScene
    files: list[Path]
    folder: CameraFolder
    config: DataConfig
    options: DataOptions

    @property
    def photos(self) -> SceneFolder:
        """Return the folder of the photographs, or of a video's chosen frames."""
        return SceneFolder.at(self.folder.images if self.found.is_video else self.found.folder.root)

    @property
    def images(self) -> list[Path]:
        """Return the files of the photographs."""
        return sorted(self.folder.images.rglob("*.jpg")) if self.found.is_video else self.files

    def settings(self, seed: int) -> str:
        """Return the settings that affect the search for cameras, as one text."""
        video, frames = (self.config.video_frames, self.config.max_side), self.options.frames
        of_videos = (*video, frames) if self.found.is_video else ()
        return repr((seed, self.config.camera_per_image, self.options.cameras, *of_videos))


def with_cameras(
    found: FoundScene, config: DataConfig, search: CameraSearch, options: DataOptions = DataOptions()
) -> FoundScene:
    """Return the capture with its cameras; if it has none, search for them.

    An interrupted search leaves its state in the search's folder. A failed search leaves nothing.

    Raises SceneError if too few photographs can be read or placed. Raises ConfigError without pycolmap, and for a video
    without PyAV. Also raises the errors of `search.tell`.
    """
    if found.kind is not None:
        return found
    folder = CameraFolder(search.folder or temporary_folder("mgsr-cameras-"))
    task = _Task(found, _files_of(found), folder, config, options)
    photographs, settings = key_of(task.files, found.folder.root), task.settings(search.seed)
    state = None
    if search.resume or search.known_only:
        state = folder.state(photographs, None if search.known_only else settings)
    if state is None or not state.finished:
        if search.known_only:
            raise no_cameras_in(folder.path, found.given)
        require_pycolmap()
        try:
            state = _searched(task, state or _new_search(folder, photographs, settings), search)
        except (SceneError, ConfigError):
            folder.clear()
            raise
    return _as_scene(found, folder.read(task.photos, (*state.notes, _FOUND)), task.photos)


def facts_without_cameras(found: FoundScene) -> dict[str, Any]:
    """Return the known facts of a capture before the search for its cameras, by display name."""
    return {
        "name": found.name,
        "format": VIDEO if found.is_video else PHOTOGRAPHS,
        "files": len(_files_of(found)),
        "cameras": "none; a run searches for them",
    }


def _files_of(found: FoundScene) -> list[Path]:
    """Return the photographs or the videos of a capture without cameras."""
    root = found.folder.root
    return videos_below(root) if found.is_video else find_photos(root, found.given)


def _new_search(folder: CameraFolder, photographs: str, settings: str) -> SearchState:
    """Clear the folder and return the state of a search that begins."""
    folder.clear()
    state = SearchState(photographs, settings)
    folder.write_state(state)
    return state


def _searched(task: _Task, state: SearchState, search: CameraSearch) -> SearchState:
    """Search for the cameras, from where an interrupted search stopped, and leave them in the folder."""
    if task.found.is_video:
        if not state.frames or len(task.images) != state.frames:
            state = _with_frames(task, state, search)
        search = replace(search, tell=search.share(_FRAMES, 1.0))
    with tempfile.TemporaryDirectory(prefix="mgsr-poses-") as work:
        gathered = gather(task.photos.root, task.images, Path(work, "images"), search.share(0, _GATHERED))
        for note in gathered.notes:  # said now, because matching may take an hour
            search.say(note)
        lenses = lenses_of(gathered.shots, task.config.camera_per_image, search)
        search = replace(search, tell=search.share(_GATHERED, 1.0))
        model, notes = _kept_model(Path(work), task, lenses, search)
        _rename(model, gathered.originals)
        finished = replace(state, finished=True, notes=(*state.notes, *gathered.notes, *notes))
        task.folder.finish(model, finished)
    return finished


def _with_frames(task: _Task, state: SearchState, search: CameraSearch) -> SearchState:
    """Choose frames of the videos; return the state after that."""
    shutil.rmtree(task.folder.images, ignore_errors=True)
    count, notes = choose_frames_of(task.files, task.folder.images, task.config, search, task.options.frames)
    state = replace(state, notes=notes, frames=count)
    task.folder.write_state(state)
    return state


def choose_frames_of(
    videos: Sequence[Path],
    folder: Path,
    config: DataConfig,
    search: CameraSearch,
    options: FrameOptions = FrameOptions(),
) -> tuple[int, tuple[str, ...]]:
    """Write chosen frames of videos into a folder, or of several videos into a folder each; return their number.

    Also returns a line on each video. Raises SceneError for videos that can't be used, and ConfigError without PyAV.
    """
    notes: list[str] = []
    count = 0
    for number, video in enumerate(videos):
        tell = search.share(_FRAMES * number / len(videos), _FRAMES * (number + 1) / len(videos))
        search.say(f"choosing frames of {video.name}")
        most = max(config.video_frames // len(videos), 1)
        place = folder / f"video_{number + 1}" if len(videos) > 1 else folder
        files, line = write_frames(video, place, most, config.max_side, tell, options=options)
        search.say(line)
        notes.append(line)
        count += len(files)
    return count, tuple(notes)


def lenses_of(shots: Sequence[PhotoFile], camera_per_image: bool, search: CameraSearch) -> list[SharedLens]:
    """Return the lenses of the photographs, and say how many there are."""
    if camera_per_image:
        search.say("a separate camera for each photograph")
        return [SharedLens((shot,)) for shot in shots]
    lenses = share_lenses(shots)
    search.say(describe_lenses(lenses))
    return lenses


def _kept_model(
    work: Path, task: _Task, lenses: Sequence[SharedLens], search: CameraSearch
) -> tuple[Any, tuple[str, ...]]:
    """Return the model and notes on it; COLMAP's database is kept in the folder until the search is complete."""
    database, kept = work / "database.db", task.folder.database
    if kept.is_file():
        shutil.copyfile(kept, database)
    keeper = DatabaseKeeper(database, kept)
    try:
        folder = SearchFolder(work / "images", database, keeper)
        return find_model(folder, lenses, task.found.is_video, search, task.options.cameras)
    except Cancelled:
        keeper.keep()
        raise


def _rename(model: Any, originals: Mapping[str, str]) -> None:
    """Give the photographs of a pycolmap.Reconstruction the names of the user's files."""
    for image in model.images.values():
        image.name = originals[image.name]


def _as_scene(found: FoundScene, capture: Capture, folder: SceneFolder) -> FoundScene:
    name = VIDEO if found.is_video else PHOTOGRAPHS
    kind = Format(name, "photographs or a video without cameras", lambda root: None, lambda folder: capture)
    return replace(found, kind=kind, folder=folder)
