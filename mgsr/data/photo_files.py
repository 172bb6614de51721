"""Find photographs by the names that a capture's files give them, wherever they lie below the scene's folder.

Files name photographs in many ways. Some paths are relative to a program's own folder, or absolute on another machine.
Some names lack folder or extension. Other files were converted, cropped or reduced later.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from mgsr.data.files import IMAGE_SUFFIXES, LONGEST_NAME, LONGEST_PATH, folded, images_below, in_any_case
from mgsr.data.odd_files import RAW_CURE, RAW_SUFFIXES
from mgsr.errors import MissingPhotoError, SceneError

# Folders of maps (such as depth) that programs write under the photographs' names.
_MAPS = re.compile("depth|normal|confidence|semantic|segment|mask|albedo|rough|metal|thumb|render", re.IGNORECASE)
_REDUCED = re.compile(r"_(\d{1,2})$")


@dataclass(frozen=True)
class FoundPhotos:
    """Where photographs lie.

    paths: for each name its file, or a SceneError with the reason (MissingPhotoError for a missing file). file: the
    file that names them, for messages. notes: messages to the user.
    """

    file: str
    paths: list[Path | SceneError]
    notes: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """Return the files that were found."""
        return [path for path in self.paths if isinstance(path, Path)]


@dataclass(frozen=True)
class SceneFolder:
    """The folder of a scene.

    root: where the format's own files lie. top: the user's folder, which is the root or above it. Photographs that the
    root does not hold are looked for below it.
    """

    root: Path
    top: Path

    @classmethod
    def at(cls, root: Path) -> SceneFolder:
        """Return a scene folder that is both the root and the top."""
        return cls(root, root)

    def find_photos(
        self, file: str, names: Sequence[Any], places: Sequence[str] = (".",), labels: bool = False
    ) -> FoundPhotos:
        """Find the photographs that `file` names.

        names: paths as the file has them; anything else is an error of that photograph.
        places: the folders, below the root, to which the paths may be relative.
        labels: whether the names are no paths, so that photographs may lie in any folder without a note.

        A photograph that is in none of these places is searched for anywhere below the root, and then below the top.
        The file that agrees with most of the path's last folders is taken. It must have the same name, or else be the
        only file of that stem with another extension.
        """
        return _NameSearch(self, file, names, places, labels).result()

    def shown(self, path: Path) -> str:
        """Return a path below the top as messages show it."""
        return os.path.relpath(path, self.root if path.is_relative_to(self.root) else self.top)

    def inside(self, path: str) -> Path | None:
        """Return an absolute path, or one relative to the working folder, as one below the top; None for others.

        An uploaded scene must not be able to make MGSR read the machine's other files.
        """
        absolute = PurePosixPath(os.path.abspath(path))
        tops = (os.path.abspath(self.top), os.path.realpath(self.top))
        return next((self.top / absolute.relative_to(top) for top in tops if absolute.is_relative_to(top)), None)

    def find_file(self, name: Any, what: str) -> Path | None:
        """Find a file, other than a photograph, that a file of the scene names.

        what: the kind of file, for messages. The search tries the named path below the root and the top, ignoring case.
        It then matches the path's last folders, as after a move. Returns None where the file is missing. Raises
        SceneError for names that are not paths.
        """
        text = _path_text(name)
        if isinstance(text, SceneError):
            raise SceneError(f"{what}: {str(text).replace('an image', 'a file')}")
        places = [self.inside(os.path.join(home, text)) for home in (self.root, self.top)]
        parts = [part for part in PurePosixPath(text).parts if part not in ("..", "/")]
        tails = [self.root / PurePosixPath(*parts[first:]) for first in range(len(parts))]
        for path in [path for path in places if path is not None] + tails:
            if path.is_file():
                return path
            if path == self.top:
                continue
            if found := in_any_case(self.top, path.parent, [path.name]):
                return found
        return None

    def images_named(self, name: str) -> list[Path]:
        """Return the images with the folded name or stem `name`, below the root or else below the top."""
        below_root = self._below_root.get(name, [])
        return below_root if below_root or self.top == self.root else self._below_top.get(name, [])

    @cached_property
    def _below_root(self) -> dict[str, list[Path]]:
        return _index(self.root)

    @cached_property
    def _below_top(self) -> dict[str, list[Path]]:
        return _index(self.top)


def _index(folder: Path) -> dict[str, list[Path]]:
    index: dict[str, list[Path]] = {}
    for path in images_below(folder):
        for name in {folded(path.name), folded(path.stem)}:
            index.setdefault(name, []).append(path)
    return index


@dataclass(frozen=True)
class _FileCandidate:
    """A file that may be the photograph.

    agreeing: how many of the path's last folders it agrees with. same_name: whether its extension agrees too. plain:
    whether it lies outside folders of maps. reduction: 4 in images_4, else 1.
    """

    path: Path
    agreeing: int
    same_name: bool
    plain: bool
    reduction: int

    @property
    def rank(self) -> tuple[int, bool, bool, int]:
        """Return the sort key of candidates; larger is better."""
        return self.agreeing, self.same_name, self.plain, -self.reduction

    @property
    def base(self) -> Path:
        """Return the folder that the path is relative to if it means this file."""
        return self.path.parents[self.agreeing]


class _Taken:
    """The files that were found at the places that their names give."""

    def __init__(self, paths: set[Path]) -> None:
        self._paths = paths
        self._folders = {path.parent for path in paths}
        self._stems = {folded(path.stem) for path in paths}
        self._twins: dict[Path, bool] = {}

    def rules_out(self, offer: _FileCandidate) -> bool:
        """Return whether a file can't be another photograph.

        It is taken already, or it lies among other images of taken photographs, in a folder that the photograph's name
        lacks.
        """
        folder = offer.path.parent
        if folder not in self._twins:
            there = {folded(file.stem) for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES}
            self._twins[folder] = folder not in self._folders and bool(there & self._stems)
        return offer.path in self._paths or (offer.agreeing == 0 and self._twins[folder])


class _NameSearch:
    """One look-up of all names of a file, as each name gives hints about the others."""

    def __init__(
        self, folder: SceneFolder, file: str, names: Sequence[Any], places: Sequence[str], labels: bool
    ) -> None:
        self._folder, self._file, self._labels = folder, file, labels
        self._names = [_path_text(name) for name in names]
        self._places = places

    def result(self) -> FoundPhotos:
        stated = self._stated()
        taken = _Taken({path for path in stated if path is not None})
        offers = {
            number: self._offers(name, taken)
            for number, (name, path) in enumerate(zip(self._names, stated, strict=True))
            if path is None and isinstance(name, str)
        }
        bases = Counter(base for found in offers.values() for base in {offer.base for offer in found})
        chosen = [self._chosen(number, path, offers.get(number, []), bases) for number, path in enumerate(stated)]
        paths = [item.path if isinstance(item, _FileCandidate) else item for item in self._one_each(chosen)]
        return FoundPhotos(self._file, paths, self._notes(stated, paths))

    def _one_each(
        self, chosen: Sequence[_FileCandidate | Path | SceneError]
    ) -> list[_FileCandidate | Path | SceneError]:
        """Return the choices with each file kept only for the one name that agrees with it best.

        The other names that chose it get a MissingPhotoError.
        """
        claims: dict[Path, list[_FileCandidate]] = {}
        for item in chosen:
            if isinstance(item, _FileCandidate):
                claims.setdefault(item.path, []).append(item)
        best = {path: max(item.rank for item in items) for path, items in claims.items()}
        alone = {path: sum(item.rank == best[path] for item in items) == 1 for path, items in claims.items()}
        return [
            MissingPhotoError(f"{self._names[number]} is missing")
            if isinstance(item, _FileCandidate) and not (alone[item.path] and item.rank == best[item.path])
            else item
            for number, item in enumerate(chosen)
        ]

    def _stated(self) -> list[Path | None]:
        """Return the files at the places that the names give, None for the others.

        Of several places, the one with most of the files comes first.
        """
        columns = [[self._at(place, name) for name in self._names] for place in self._places]
        columns.sort(key=lambda column: -sum(path is not None for path in column))
        return [next((path for path in row if path is not None), None) for row in zip(*columns, strict=True)]

    def _at(self, place: str, name: str | SceneError) -> Path | None:
        if isinstance(name, SceneError):
            return None
        path = self._folder.inside(os.path.join(self._folder.root, place, name))  # an absolute name stays as it is
        if path is None or path == self._folder.top or path.suffix.lower() in RAW_SUFFIXES:
            return None
        names = [path.name, *[path.name + suffix for suffix in IMAGE_SUFFIXES]]
        there = next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)
        return there or in_any_case(self._folder.top, path.parent, names)

    def _offers(self, name: str, taken: _Taken) -> list[_FileCandidate]:
        """Return the best files for a name, equally good, below the root or else the top.

        Files that other names state are excluded. So are those in folders that hold other images of such photographs:
        depth maps, or reduced or older copies.
        """
        parts = [folded(part) for part in PurePosixPath(name).parts if part not in ("..", "/")]
        files = self._folder.images_named(parts[-1]) or self._folder.images_named(PurePosixPath(parts[-1]).stem)
        offers = [self._candidate(path, parts) for path in files]
        offers = [offer for offer in offers if not taken.rules_out(offer)]
        best = max((offer.rank for offer in offers), default=None)
        return [offer for offer in offers if offer.rank == best]

    def _candidate(self, path: Path, parts: Sequence[str]) -> _FileCandidate:
        folders = path.relative_to(self._folder.top).parts[:-1]
        pairs = zip(reversed(folders), reversed(parts[:-1]), strict=False)
        agreeing = next((i for i, (mine, asked) in enumerate(pairs) if folded(mine) != asked), None)
        if agreeing is None:
            agreeing = min(len(folders), len(parts) - 1)
        reduced = [reduction(folder) for folder in folders]
        plain = not any(_MAPS.search(folder) for folder in folders)
        same_name = parts[-1] in (folded(path.name), folded(path.stem))
        return _FileCandidate(path, agreeing, same_name, plain, max(reduced, default=1))

    def _chosen(
        self, number: int, stated: Path | None, offers: Sequence[_FileCandidate], bases: Counter[Path]
    ) -> _FileCandidate | Path | SceneError:
        name = self._names[number]
        if isinstance(name, SceneError):
            return SceneError(f"{self._file}, photograph {number + 1}: {name}")
        if stated is not None:
            return stated
        if not offers and PurePosixPath(name).suffix.lower() in RAW_SUFFIXES:
            return SceneError(f"{name}: MGSR does not read raw photographs; {RAW_CURE}")
        if not offers:
            return MissingPhotoError(f"{name} is missing")
        most = max(bases[offer.base] for offer in offers)
        best = sorted((offer for offer in offers if bases[offer.base] == most), key=lambda offer: offer.path)
        if len(best) == 1:
            return best[0]
        both = " or ".join(self._folder.shown(offer.path) for offer in best[:2])
        return SceneError(
            f"{self._file}: the photograph {name!r} may be {both}; write its folder as well, or use different names"
        )

    def _notes(self, stated: Sequence[Path | None], paths: Sequence[Path | SceneError]) -> tuple[str, ...]:
        moved = [
            (name, path)
            for name, place, path in zip(self._names, stated, paths, strict=True)
            if place is None and isinstance(path, Path) and isinstance(name, str)
        ]
        return (*self._note_of_places(moved), *self._note_of_extensions(moved), *_note_of_reduction(moved))

    def _note_of_places(self, moved: Sequence[tuple[str, Path]]) -> tuple[str, ...]:
        homes = [home / place for home in (self._folder.root, self._folder.top) for place in self._places]
        elsewhere = [
            (name, path) for name, path in moved if path.parent not in [(home / name).parent for home in homes]
        ]
        if self._labels or not elsewhere:
            return ()
        name, path = elsewhere[0]
        count = f"{len(elsewhere)} of {len(self._names)} photographs are in other folders than {self._file} says"
        return (f"{count}; {name} is read from {self._folder.shown(path)}",)

    def _note_of_extensions(self, moved: Sequence[tuple[str, Path]]) -> tuple[str, ...]:
        other = [
            (name, path)
            for name, path in moved
            if PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES
            and PurePosixPath(name).suffix.lower() != path.suffix.lower()
        ]
        if not other:
            return ()
        name, path = other[0]
        count = f"{len(other)} of {len(self._names)} photographs have other extensions than {self._file} says"
        return (f"{count}; {self._folder.shown(path)} is read for {name}",)


def reduction(folder: str) -> int:
    """Return how many times smaller the photographs in a folder of that name are: 4 in images_4, else 1."""
    match = _REDUCED.search(folder)
    return int(match[1]) or 1 if match else 1


def _note_of_reduction(moved: Sequence[tuple[str, Path]]) -> tuple[str, ...]:
    folders = {path.parent.name for name, path in moved if _REDUCED.search(path.parent.name)}
    folders -= {PurePosixPath(name).parent.name for name, _ in moved}
    if not folders:
        return ()
    return (
        f"the photographs are read from {', '.join(sorted(folders))}; the cameras are scaled to the photographs' size",
    )


def _path_text(name: Any) -> str | SceneError:
    """Return a name as a path with slashes, or a SceneError with its mistake."""
    if not isinstance(name, str) or not name.strip():
        return SceneError(f"expected the path of an image, got {str(name)[:80]!r}")
    text = re.sub(r"^file://", "", name.strip()).replace("\\", "/")
    text = re.sub(r"^[A-Za-z]:/", "/", text)
    parts = text.split("/")
    if "\0" in text or len(text) > LONGEST_PATH or any(len(part.encode()) > LONGEST_NAME for part in parts):
        return SceneError(f"{text[:80]!r}...: a file name may not be so long or have a zero byte; fix the file")
    if not [part for part in parts if part not in ("", ".", "..")]:
        return SceneError(f"expected the path of an image, got {name[:80]!r}")
    return text
