"""Find the scene at the user's path: in the folder itself, below it, or around it."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mgsr.data.archive import ARCHIVE_SUFFIXES
from mgsr.data.camera_search import SEARCH_STATE
from mgsr.data.capture import Format, Photo
from mgsr.data.files import MASK_FOLDERS, images_below
from mgsr.data.formats import all_formats
from mgsr.data.odd_files import RAW_CURE, RAW_SUFFIXES, VIDEO_CURE, is_video_name, videos_below, what_instead
from mgsr.data.photo_files import SceneFolder
from mgsr.data.unread import unread_cameras
from mgsr.errors import SceneError

# Limits of the search for a scene: depth, and number of folders.
_DEEPEST = 8
_MOST_FOLDERS = 2000

# Limits of the search around a part of a scene: number of enclosing folders, and depth.
_FARTHEST_AROUND = 3
_DEEPEST_AROUND = 4

# Cameras of fewer photographs can't be found.
FEWEST_PHOTOS = 3

# Files that may hold cameras.
_CAMERA_SUFFIXES = (".csv", ".xml", ".json", ".sfm", ".txt", ".nvm", ".out", ".npz", ".npy")

# Folders that programs make for their files: a scene has the name of the folder that holds them.
_PROGRAMS_FOLDER = re.compile(r"\d+$|sparse|dense|colmap|sfm|.*_calibration|.*distorted|output$|images$|keyframes$")


@dataclass(frozen=True)
class FoundScene:
    """A scene's folder, format and name, with notes for the user on where it was found and other ways to read it.

    kind: None for photographs without cameras. given: the user's path. is_video: whether frames of a video are the
    photographs.
    """

    folder: SceneFolder
    kind: Format | None
    name: str
    notes: tuple[str, ...]
    given: Path
    is_video: bool = False


def find_scene(folder: Path, given: Path, confined: bool = False) -> FoundScene:
    """Find the scene in a folder: the nearest folder that a format recognises, itself first and then those below.

    given: the user's path, for messages: the folder, or the archive that it was unpacked from. confined: never search
    outside the folder.

    A folder of photographs with its cameras beside it belongs to the enclosing scene, unless it comes from an archive.
    Photographs that no format recognises, or else a video, are a scene without cameras.

    Raises SceneError, with the folder's content and the remedy, if it finds no scene or several.
    """
    formats = all_formats()
    for level in _levels(folder):
        scenes = [path for path in level if _recognised(path, formats)]
        if len(scenes) > 1:
            names = ", ".join(str(path.relative_to(folder)) for path in scenes[:3])
            raise SceneError(f"{given}: it holds {len(scenes)} scenes ({names}); choose one of them")
        if scenes:
            return _found(SceneFolder(scenes[0], folder), formats, given)
    if given.is_dir() and not confined and (around := scene_around(folder)):
        return around
    return _without_cameras(folder, given, formats)


def _levels(folder: Path) -> Iterator[list[Path]]:
    """Yield the folder, then the folders in it, then those in these, level by level."""
    level, seen = [folder], {os.path.realpath(folder)}
    for _ in range(_DEEPEST):
        if not level:
            return
        yield level
        level = [inner for path in level for inner in _inner(path, seen)]


def _inner(folder: Path, seen: set[str]) -> list[Path]:
    """Return the folders in a folder that may hold a scene and are not in `seen`, and add them to it.

    Cameras that an earlier run found for its photographs are no scene of their own.
    """
    try:
        paths = sorted(path for path in folder.iterdir() if path.is_dir())
    except OSError:
        return []
    found = []
    for path in paths:
        real = os.path.realpath(path)
        hidden = path.name.startswith((".", "__")) or path.name.lower() in MASK_FOLDERS
        hidden = hidden or (path / SEARCH_STATE).is_file()
        if not hidden and real not in seen and len(seen) < _MOST_FOLDERS:
            seen.add(real)
            found.append(path)
    return found


def _recognised(root: Path, formats: Sequence[Format]) -> list[tuple[Format, str]]:
    """Return the formats that recognise the folder, each with the file that identifies it."""
    return [(kind, file) for kind in formats if (file := kind.recognises(root))]


def _found(folder: SceneFolder, formats: Sequence[Format], given: Path) -> FoundScene:
    (kind, file), *others = _recognised(folder.root, formats)
    left = " and ".join(f"{name} ({other.name})" for other, name in others)
    notes = (f"the scene is read from {file} ({kind.name}); {left} in the same folder is ignored",) if others else ()
    return FoundScene(folder, kind, _name(folder), notes, given)


def _name(folder: SceneFolder) -> str:
    """Return the name of the scene's folder, or of the nearest one around it that is not named by a program."""
    path = folder.root
    while path != folder.top and _PROGRAMS_FOLDER.match(path.name):
        path = path.parent
    return path.name or path.resolve().name


def scene_around(folder: Path) -> FoundScene | None:
    """Return the scene that a folder of photographs alone, or of cameras alone, is a part of; None without one.

    The search takes the nearest enclosing scene with some photographs or cameras in this folder.
    """
    inner, formats = folder.resolve(), all_formats()
    for outer in inner.parents[:_FARTHEST_AROUND]:
        found = _scene_with(outer, inner, formats)
        if found is not None:
            note = f"{inner.name} is a part of the scene {found.name}, so {found.name} is read"
            return replace(found, notes=(note, *found.notes))
    return None


def _scene_with(outer: Path, inner: Path, formats: Sequence[Format]) -> FoundScene | None:
    """Return the scene in the outer folder if its cameras or most of its photographs lie in the inner one."""
    for level in itertools.islice(_levels(outer), _DEEPEST_AROUND):
        scenes = [path for path in level if _recognised(path, formats)]
        if len(scenes) > 1:
            return None
        if scenes:
            found = _found(SceneFolder(scenes[0], outer), formats, inner)
            photos = _photos(found)
            inside = sum(photo.image.is_relative_to(inner) for photo in photos)
            _, file = _recognised(scenes[0], formats)[0]
            is_part = 2 * inside > len(photos) or (scenes[0] / file).is_relative_to(inner)
            return found if photos and is_part else None
    return None


def _photos(found: FoundScene) -> list[Photo]:
    assert found.kind is not None
    try:
        return found.kind.read(found.folder).photos
    except SceneError:
        return []


def _without_cameras(folder: Path, given: Path, formats: Sequence[Format]) -> FoundScene:
    """Return the photographs, or else the videos, of a folder that no format recognises.

    Raises SceneError, with a remedy, if the folder has unreadable cameras, or neither enough photographs nor a video.
    """
    files = [path for level in _levels(folder) for inner in level for path in _files(inner)]
    if unread := unread_cameras(folder):
        raise SceneError(f"{given}: {unread}")
    for path in files:
        if path.suffix.lower() in _CAMERA_SUFFIXES and (odd := what_instead(path)):
            raise SceneError(f"{given}: {path.name} {odd}")
    images = images_below(folder)
    is_video = len(images) < FEWEST_PHOTOS and bool(videos_below(folder))
    if len(images) < FEWEST_PHOTOS and not is_video:
        raise _unknown(folder, given, formats, files, len(images))
    whole = SceneFolder.at(folder)
    return FoundScene(whole, None, _name(whole), (), given, is_video)


def _unknown(folder: Path, given: Path, formats: Sequence[Format], files: Sequence[Path], images: int) -> SceneError:
    """Return the error for a folder without scene, photographs and videos. It lists the content and the remedy."""
    looked = "; ".join(kind.looks_for for kind in formats)
    archives = [path.name for path in files if path.name.lower().endswith(ARCHIVE_SUFFIXES)]
    videos = [path.name for path in files if is_video_name(path)]
    raw = [path.name for path in files if path.suffix.lower() in RAW_SUFFIXES]
    if archives:
        return SceneError(f"{given}: it holds no known scene but another archive, {archives[0]}; unpack that first")
    if images:
        return SceneError(
            f"{given}: it holds {images} images but no cameras; at least {FEWEST_PHOTOS} are needed to find cameras, "
            f"20 or more are good. MGSR looked for: {looked}. See docs/inputs.md"
        )
    if videos:
        return SceneError(f"{given}: it holds a video ({videos[0]}) of a kind that is not read; {VIDEO_CURE}")
    if raw:
        return SceneError(f"{given}: it holds raw photographs ({raw[0]}), which MGSR does not read; {RAW_CURE}")
    state = "it holds no known scene" if any(folder.iterdir()) else "the folder is empty"
    return SceneError(f"{given}: {state}. MGSR looked for: {looked}. See docs/inputs.md")


def _files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    except OSError:
        return []
