"""Files of a capture: JSON, paths that must stay inside the scene's folder, masks, and the names of views."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from mgsr.errors import SceneError, in_short

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".webp", ".bmp", ".heic", ".heif")
MASK_SUFFIXES = (".png", ".jpg", ".jpeg")
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
    """Like `inside`, and the first image type that exists where the name has no extension.

    If none exists, the path as it stands (or with .png), so that the message about the missing file can name it.
    """
    path = inside(root, text, source)
    if path.is_file():
        return path
    candidates = [path.with_name(path.name + suffix) for suffix in IMAGE_SUFFIXES]
    fallback = path if path.suffix.lower() in IMAGE_SUFFIXES else candidates[0]
    return next((candidate for candidate in candidates if candidate.is_file()), fallback)


def find_mask(root: Path, image: Path) -> Path | None:
    """The mask of an image in `root`/masks or `root`/mask, or beside the image as RealityCapture has it.

    In the folder: the image's name with .png or .jpg in place of, or after, its extension, also with _mask or .mask
    before (``0001.png``, ``0001.jpg.png``, ``0001_mask.png``, ``0001.mask.png``); beside it: the last two alone. The
    image's folders below the folder of all images count where masks/ has them too (``masks/left/0001.png``).
    """
    marked = (image.stem + "_mask", image.stem + ".mask", image.name + ".mask")
    parts = image.relative_to(root).parts
    for folder in MASK_FOLDERS:
        if not (root / folder).is_dir():
            continue
        for first in range(len(parts)):
            found = _first_mask(root.joinpath(folder, *parts[first:-1]), (image.stem, image.name, *marked))
            if found and found != image:
                return found
    return _first_mask(image.parent, marked[1:])


def _first_mask(place: Path, names: Sequence[str]) -> Path | None:
    paths = (place / (name + suffix) for name in names for suffix in MASK_SUFFIXES)
    return next((path for path in paths if os.path.isfile(path)), None)  # names that are too long are no error here


def images_below(root: Path) -> list[Path]:
    """Every image file in the folder and below, without those of the mask folders, hidden folders and masks beside
    images; sorted."""
    found = []
    for folder, inner, names in os.walk(root):
        inner[:] = sorted(name for name in inner if name not in MASK_FOLDERS and not name.startswith((".", "__")))
        found += [Path(folder, name) for name in sorted(names) if _is_image(name)]
    return found


def _is_image(name: str) -> bool:
    path = PurePosixPath(name)
    return path.suffix.lower() in IMAGE_SUFFIXES and not name.startswith(".") and not path.stem.endswith(".mask")


class ImageIndex:
    """The photographs below a folder, found by the names that programs give them: with or without folders and
    extension, in any case."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._by_name: dict[str, list[Path]] = {}
        for path in images_below(root):
            for name in (path.name.lower(), path.stem.lower()):
                self._by_name.setdefault(name, []).append(path)

    def find(self, label: str, source: str) -> Path | None:
        """The photograph of that name, or None. Raises SceneError where several folders have one."""
        name = PurePosixPath(label.replace("\\", "/")).name.lower()
        found = sorted(set(self._by_name.get(name, [])))
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
