"""Files of a capture: JSON, paths that must stay inside the scene's folder, and the names of views."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from mgsr.data.odd_files import require_content
from mgsr.errors import SceneError, in_short

# In order of preference, for a photograph that exists in several formats.
IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".webp", ".bmp", ".heic", ".heif"),
    *(".jfif", ".tga", ".ppm", ".pgm", ".pnm", ".jp2", ".j2k", ".gif", ".hdr", ".dpx", ".psd"),
)
MASK_FOLDERS = ("masks", "mask")
IGNORED_PREFIX = "dynamic_mask_"

# File systems allow 255 bytes, and the names of masks add some; longer names come from damaged or hostile files.
LONGEST_NAME = 240
LONGEST_PATH = 4000


# NaN and infinity as C and C++ print them, Windows' run-time library among them.
_NO_NUMBER = r"[-+]?(?:nan(?:\(\w*\))?|inf(?:inity)?|1\.#\w+)"
_NO_NUMBER_IN_JSON = re.compile(rf"(?<=[\[,:\s]){_NO_NUMBER}(?=[\s,\]}}])", re.IGNORECASE)


def text_number(text: str) -> float:
    """Return a number of a text file as a float, with NaN for what C prints for NaN and infinity.

    Examples of such words are ``-nan(ind)`` and ``1.#QNAN``. Raises ValueError for text that is not a number.
    """
    return math.nan if re.fullmatch(_NO_NUMBER, text, re.IGNORECASE) else float(text)


def read_json(path: Path) -> Any:
    """Read a JSON file, with NaN for the words that C prints for NaN and infinity.

    Raises SceneError, which names the line of a mistake or the file's real kind.
    """
    require_content(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
        content = _parsed(text)
        if "\\ud" in text.lower():  # JSON can name halves of characters, which no file name or message can hold
            json.dumps(content, ensure_ascii=False).encode()
        return content
    except json.JSONDecodeError as error:
        raise SceneError(f"{path.name}: not valid JSON at line {error.lineno}: {error.msg}; fix the file") from error
    except RecursionError as error:
        raise SceneError(f"{path.name}: the JSON is nested too deeply for a capture; export it again") from error
    except (OSError, ValueError) as error:
        raise SceneError(f"{path.name}: this file is not JSON text: {in_short(error)}; export it again") from error


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        repaired = _NO_NUMBER_IN_JSON.sub("NaN", text)
        if repaired == text:
            raise
        return json.loads(repaired)


def number(values: Mapping[str, Any], name: str, source: str) -> float:
    """Return values[name] as a float. Raises SceneError naming `source` for anything but a finite number."""
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _finite(value):
        raise SceneError(f"{source}: {name}: expected a number, got {str(value)[:80]!r}; fix the file")
    return float(value)


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # JSON's whole numbers have no limit
        return False


def in_any_case(root: Path, folder: Path, names: Sequence[str]) -> Path | None:
    """Return the first existing file of these names in a folder below the root; names match as `folded` has them.

    Returns None where a folder on the way, or every file, is missing.
    """
    place = root
    for wanted in [*[[part] for part in folder.relative_to(place).parts], names]:
        there = _listed(place, place.stat().st_mtime_ns) if place.is_dir() else {}
        same = next((there[folded(name)] for name in wanted if folded(name) in there), None)
        if same is None:
            return None
        place /= same
    return place


@lru_cache(maxsize=16)
def _listed(folder: Path, changed: int) -> dict[str, str]:
    """Return a folder's names by their folded form, cached until the folder's time of change (ns) differs.

    Reading the folder again for each missing file of thousands would take minutes.
    """
    return {folded(name): name for name in sorted(os.listdir(folder), reverse=True)}


def folded(name: str) -> str:
    """Return a name in a form without differences of case and of accent encoding, which file systems change."""
    return unicodedata.normalize("NFC", name).casefold()


def images_below(root: Path) -> list[Path]:
    """Return every photograph in the folder and below: `all_images` without masks that lie beside photographs."""
    return [path for path in all_images(root) if not is_mask_beside(path)]


def is_mask_beside(path: Path) -> bool:
    """Return whether an image's name marks it as the mask of another image.

    Such names are RealityCapture's ``a.mask.png`` and instant-ngp's ``dynamic_mask_a.png``.
    """
    return path.stem.lower().endswith(".mask") or path.name.lower().startswith(IGNORED_PREFIX)


def is_photo(path: Path) -> bool:
    """Return whether a path has the name of a photograph."""
    return _is_image(path.name) and not is_mask_beside(path)


def all_images(root: Path) -> list[Path]:
    """Return every image file in the folder and below, sorted, except hidden files and mask folders.

    Links to folders are followed, each folder once.
    """
    found, walked = [], {os.path.realpath(root)}
    for folder, inner, names in os.walk(root, followlinks=True):
        inner[:] = sorted(name for name in inner if _may_hold_images(name) and _is_new(Path(folder, name), walked))
        found += [Path(folder, name) for name in sorted(names) if _is_image(name)]
    return found


def _may_hold_images(folder: str) -> bool:
    return folder.lower() not in MASK_FOLDERS and not folder.startswith((".", "__"))


def _is_new(folder: Path, walked: set[str]) -> bool:
    """Return whether a folder is visited for the first time, and mark it as visited."""
    real = os.path.realpath(folder)
    new = real not in walked
    walked.add(real)
    return new


def _is_image(name: str) -> bool:
    return PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES and not name.startswith(".")


def view_names(images: Sequence[Path]) -> list[str]:
    """Return a unique name for each image: its file name without extension, after the folders that differ.

    The extension is kept where two names would be equal, and a number is added where they still would.
    """
    parents = [str(image.parent) for image in images]
    common = os.path.commonpath(parents) if parents else ""
    relative = [PurePosixPath(image.relative_to(common).as_posix()) for image in images]
    names = ["_".join([*path.parts[:-1], path.stem]) for path in relative]
    count = Counter(names)
    names = [
        name if count[name] == 1 else f"{name}_{path.suffix[1:].lower()}"
        for name, path in zip(names, relative, strict=True)
    ]
    return _numbered(names)


def _numbered(names: Sequence[str]) -> list[str]:
    taken: set[str] = set()
    unique = []
    for name in names:
        tries = itertools.chain([name], (f"{name}_{number}" for number in itertools.count(2)))
        unique.append(next(text for text in tries if text not in taken))
        taken.add(unique[-1])
    return unique
