"""Find the cameras of a capture that has none: photographs, or a video, by structure from motion."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mgsr.config import DataConfig
from mgsr.data.archive import temporary_folder
from mgsr.data.camera_search import CameraSearch
from mgsr.data.capture import Capture, Format
from mgsr.data.find_scene import FoundScene
from mgsr.data.found_cameras import CameraFolder, DatabaseKeeper, SearchState, key_of, no_cameras_in
from mgsr.data.gather_photos import find_photos, gather
from mgsr.data.odd_files import videos_below
from mgsr.data.photo_files import SceneFolder
from mgsr.data.shared_lenses import Lens, Shot, describe_lenses, share_lenses
from mgsr.data.structure_from_motion import SearchFolder, find_model, require_pycolmap
from mgsr.data.video_frames import write_frames
from mgsr.errors import Cancelled, ConfigError, SceneError

# The share of the search that choosing the frames of videos takes.
_FRAMES = 0.3


# The names of these kinds of input in reports.
PHOTOGRAPHS, VIDEO = "photographs", "video"

# The share of the rest that decoding the photographs takes, and then that finding their cameras begins.
_GATHERED = 0.1

_FOUND = "the cameras were found from the photographs, which came without any: lengths have no unit"


@dataclass(frozen=True)
class _Sought:
    """Photographs whose cameras are sought: their folder and files, and whether they are frames of videos."""

    folder: SceneFolder
    images: list[Path]
    frames: bool


def with_cameras(found: FoundScene, config: DataConfig, search: CameraSearch) -> FoundScene:
    """Return the capture with its cameras, which are searched for where it has none.

    Raises SceneError where too few photographs can be read or placed, ConfigError without pycolmap, or without PyAV for
    a video; and what `search.tell` raises. A search that is interrupted leaves its state in the search's folder; one
    that fails leaves nothing.
    """
    if found.kind is not None:
        return found
    folder = CameraFolder(search.folder or temporary_folder("mgsr-cameras-"))
    root = found.folder.root
    videos = videos_below(root) if found.is_video else []
    files = videos or find_photos(root, found.given)
    of_videos = (config.video_frames, config.max_side) if videos else ()
    settings = repr((search.seed, config.camera_per_image, *of_videos))
    photographs = key_of(files, root)
    state = None
    if search.resume or search.known_only:
        state = folder.state(photographs, None if search.known_only else settings)
    if search.known_only and (state is None or not state.finished):
        raise no_cameras_in(folder.path, found.given)
    try:
        if state is None or not state.finished:
            require_pycolmap()
            state = _searched(
                found, videos, files, folder, state or _begun(folder, photographs, settings), config, search
            )
        sought = _sought(found, folder, files)
        capture = folder.read(sought.folder, (*state.notes, _FOUND))
    except (SceneError, ConfigError):
        folder.clear()
        raise
    return _as_scene(found, capture, sought.folder)


def facts_without_cameras(found: FoundScene) -> dict[str, Any]:
    """Return what is known of a capture whose cameras have not been searched for, by names for people."""
    root = found.folder.root
    files = videos_below(root) if found.is_video else find_photos(root, found.given)
    kind = VIDEO if found.is_video else PHOTOGRAPHS
    return {"name": found.name, "format": kind, "files": len(files), "cameras": "none; a run searches for them"}


def _begun(folder: CameraFolder, photographs: str, settings: str) -> SearchState:
    """Clear the folder and return the state of a search that begins."""
    folder.clear()
    state = SearchState(photographs, settings)
    folder.write_state(state)
    return state


def _sought(found: FoundScene, folder: CameraFolder, files: list[Path]) -> _Sought:
    """Return the photographs, which for videos are the frames that were chosen."""
    if not found.is_video:
        return _Sought(SceneFolder.at(found.folder.root), files, False)
    return _Sought(SceneFolder.at(folder.images), sorted(folder.images.rglob("*.jpg")), True)


def _searched(
    found: FoundScene,
    videos: Sequence[Path],
    files: list[Path],
    folder: CameraFolder,
    state: SearchState,
    config: DataConfig,
    search: CameraSearch,
) -> SearchState:
    """Search for the cameras, from where an interrupted search stopped, and leave them in the folder."""
    begin = 0.0
    if videos:
        begin = _FRAMES
        if not state.frames or len(_sought(found, folder, files).images) != state.frames:
            state = _with_frames(videos, folder, state, config, search)
    search = replace(search, tell=search.share(begin, 1.0))
    sought = _sought(found, folder, files)
    with tempfile.TemporaryDirectory(prefix="mgsr-poses-") as work:
        gathered = gather(sought.folder.root, sought.images, Path(work, "images"), search.share(0, _GATHERED))
        for note in gathered.notes:  # before an hour of matching, not after
            search.say(note)
        lenses = lenses_of(gathered.shots, config.camera_per_image, search)
        search = replace(search, tell=search.share(_GATHERED, 1.0))
        model, notes = _kept_model(Path(work), folder, lenses, sought.frames, search)
        _rename(model, gathered.originals)
        finished = replace(state, finished=True, notes=(*state.notes, *gathered.notes, *notes))
        folder.finish(model, finished)
    return finished


def _with_frames(
    videos: Sequence[Path], folder: CameraFolder, state: SearchState, config: DataConfig, search: CameraSearch
) -> SearchState:
    """Choose frames of the videos; return the state after that."""
    shutil.rmtree(folder.images, ignore_errors=True)
    count, notes = choose_frames_of(videos, folder.images, config, search)
    state = replace(state, notes=notes, frames=count)
    folder.write_state(state)
    return state


def choose_frames_of(
    videos: Sequence[Path], folder: Path, config: DataConfig, search: CameraSearch
) -> tuple[int, tuple[str, ...]]:
    """Write chosen frames of videos into a folder, and of several videos into a folder for each; return how many.

    Also returns a line on each video. Raises SceneError for videos that can't be used, and ConfigError without PyAV.
    """
    notes: list[str] = []
    count = 0
    for number, video in enumerate(videos):
        tell = search.share(_FRAMES * number / len(videos), _FRAMES * (number + 1) / len(videos))
        search.say(f"choosing frames of {video.name}")
        most = max(config.video_frames // len(videos), 1)
        place = folder / f"video_{number + 1}" if len(videos) > 1 else folder
        files, line = write_frames(video, place, most, config.max_side, tell)
        search.say(line)
        notes.append(line)
        count += len(files)
    return count, tuple(notes)


def lenses_of(shots: Sequence[Shot], camera_per_image: bool, search: CameraSearch) -> list[Lens]:
    """Return the lenses of the photographs, and say how many there are."""
    if camera_per_image:
        search.say("a camera for each photograph")
        return [Lens((shot,)) for shot in shots]
    lenses = share_lenses(shots)
    search.say(describe_lenses(lenses))
    return lenses


def _kept_model(
    work: Path, folder: CameraFolder, lenses: Sequence[Lens], frames: bool, search: CameraSearch
) -> tuple[Any, tuple[str, ...]]:
    """Return the model and notes on it; COLMAP's database is kept in the folder until the search is complete."""
    database = work / "database.db"
    if folder.database.is_file():
        shutil.copyfile(folder.database, database)
    keeper = DatabaseKeeper(database, folder.database)
    try:
        return find_model(SearchFolder(work / "images", database, keeper), lenses, frames, search)
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
