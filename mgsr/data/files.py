"""Files of a capture: JSON, paths that must stay inside the scene's folder, and the names of views."""

from __future__ import annotations

import json
import math
import os
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from mgsr.errors import SceneError, in_short

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".webp", ".bmp", ".heic", ".heif")
MASK_FOLDERS = ("masks", "mask")

# What file systems take, 255 bytes, less what names of masks add; longer names come from damaged or hostile files.
_LONGEST_NAME = 240
_LONGEST_PATH = 4000


def read_json(path: Path) -> Any:
    """The file's content. Raises SceneError that names the line of a mistake."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        content = json.loads(text)
        if "\\ud" in text.lower():  # JSON can name halves of characters, which no file name or message can hold
            json.dumps(content, ensure_ascii=False).encode()
        return content
    except json.JSONDecodeError as error:
        raise SceneError(f"{path.name}: not valid JSON at line {error.lineno}: {error.msg}; mend the file") from error
    except RecursionError as error:
        raise SceneError(f"{path.name}: JSON nested too deep to be a capture; export it again") from error
    except (OSError, ValueError) as error:
        raise SceneError(f"{path.name}: can't be read as JSON text: {in_short(error)}; export it again") from error


def number(values: Mapping[str, Any], name: str, source: str) -> float:
    """values[name] as a float. Raises SceneError naming `source` for what is no finite number."""
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _finite(value):
        raise SceneError(f"{source}: {name}: expected a number, got {str(value)[:80]!r}; mend the file")
    return float(value)


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # JSON's whole numbers have no limit
        return False


def inside(root: Path, text: Any, source: str) -> Path:
    """The path that a file of the scene names, which must lie in the scene's folder. `source` names that file.

    An uploaded scene must not be able to make MGSR read the machine's other files.
    """
    if not isinstance(text, str) or not text.strip():
        raise SceneError(f"{source}: expected the path of an image, got {text!r}")
    text = text.replace("\\", "/")
    if "\0" in text or len(text) > _LONGEST_PATH or any(len(part.encode()) > _LONGEST_NAME for part in text.split("/")):
        raise SceneError(f"{source}: {text[:80]!r}...: too long, or with a zero byte, for a file's name; mend the file")
    path = Path(os.path.normpath(root / text))
    if path == Path(os.path.normpath(root)):
        raise SceneError(
            f"{source}: expected the path of a file, got the scene's folder itself, {text!r}; mend the file"
        )
    if not path.is_relative_to(os.path.normpath(root)):
        raise SceneError(f"{source}: {text} lies outside the scene's folder; put it inside and use a relative path")
    return path


def find_image(root: Path, text: Any, source: str) -> Path:
    """Like `inside`, and the first image type that exists where the name has no extension; else a file of which `text`
    is the name but for what `folded` leaves out.

    If none exists, the path as it stands, so that the message about the missing file can name it.
    """
    path = inside(root, text, source)
    if path.is_file():
        return path
    names = [path.name, *[path.name + suffix for suffix in IMAGE_SUFFIXES]]
    candidates = [path.with_name(name) for name in names]
    found = next((candidate for candidate in candidates if candidate.is_file()), None)
    return found or _in_any_case(root, path.parent, names) or path


def _in_any_case(root: Path, folder: Path, names: Sequence[str]) -> Path | None:
    """The first of the files of these names in a folder below the root, but for what `folded` leaves out."""
    place = Path(os.path.normpath(root))
    for wanted in [*[[part] for part in folder.relative_to(place).parts], names]:
        there = _listed(place, place.stat().st_mtime_ns) if place.is_dir() else {}
        same = next((there[folded(name)] for name in wanted if folded(name) in there), None)
        if same is None:
            return None
        place /= same
    return place


@lru_cache(maxsize=16)
def _listed(folder: Path, changed: int) -> dict[str, str]:
    """A folder's names by what is left of them when `folded`, kept for the next of its files until it has changed (its
    time of change, ns): to read it for each missing file of thousands would take minutes."""
    return {folded(name): name for name in sorted(os.listdir(folder), reverse=True)}


def folded(name: str) -> str:
    """A name without what file systems and programs change: large and small letters, and how accents are written."""
    return unicodedata.normalize("NFC", name).casefold()


def images_below(root: Path) -> list[Path]:
    """Every photograph in the folder and below: as `all_images`, without masks beside photographs, ``a.mask.png``."""
    return [path for path in all_images(root) if not path.stem.lower().endswith(".mask")]


def all_images(root: Path) -> list[Path]:
    """Every image file in the folder and below, without those of mask folders and hidden ones; sorted. Links to folders
    are followed, each folder once."""
    found, walked = [], {os.path.realpath(root)}
    for folder, inner, names in os.walk(root, followlinks=True):
        inner[:] = sorted(name for name in inner if _may_hold_images(name) and _is_new(Path(folder, name), walked))
        found += [Path(folder, name) for name in sorted(names) if _is_image(name)]
    return found


def _may_hold_images(folder: str) -> bool:
    return folder.lower() not in MASK_FOLDERS and not folder.startswith((".", "__"))


def _is_new(folder: Path, walked: set[str]) -> bool:
    """Whether a folder was not walked yet; from now on it was."""
    real = os.path.realpath(folder)
    new = real not in walked
    walked.add(real)
    return new


def _is_image(name: str) -> bool:
    return PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES and not name.startswith(".")


class ImageIndex:
    """The photographs below a folder, found by the names that programs give them: with or without folders and
    extension, in any case."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._by_name: dict[str, list[Path]] = {}
        for path in images_below(root):
            for name in (folded(path.name), folded(path.stem)):
                self._by_name.setdefault(name, []).append(path)

    def find(self, label: str, source: str) -> Path | None:
        """The photograph of that name, or else of that name with another extension, or None. Raises SceneError where
        several folders have one."""
        path = PurePosixPath(label.replace("\\", "/"))
        named = self._by_name.get(folded(path.name)) or self._by_name.get(folded(path.stem), [])
        found = sorted(set(named))
        if len(found) > 1:
            both = ", ".join(str(path.relative_to(self._root)) for path in found[:2])
            raise SceneError(f"{source}: {label!r} may be {both}; leave one image of each name in the folder")
        return found[0] if found else None


def view_names(images: Sequence[Path]) -> list[str]:
    """A name for each image: its file name without extension, after the folders in which the images differ.

    Raises SceneError where two images get the same name: their renders would overwrite each other.
    """
    parents = [str(image.parent) for image in images]
    common = os.path.commonpath(parents) if parents else ""
    relative = [PurePosixPath(image.relative_to(common).as_posix()) for image in images]
    names = ["_".join([*path.parts[:-1], path.stem]) for path in relative]
    doubled = [name for name, count in Counter(names).items() if count > 1]
    if doubled:
        both = [str(image) for image, name in zip(relative, names, strict=True) if name == doubled[0]]
        raise SceneError(f"two images have the same name {doubled[0]!r}: {', '.join(both)}; rename or remove one")
    return names
