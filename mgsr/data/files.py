"""Files of a capture: JSON, paths that must stay inside the scene's folder, and the names of views."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from mgsr.errors import SceneError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".webp", ".bmp")
MASK_SUFFIXES = (".png", ".jpg", ".jpeg")


def read_json(path: Path) -> Any:
    """The file's content. Raises SceneError that names the line of a mistake."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except json.JSONDecodeError as error:
        raise SceneError(f"{path.name}: not valid JSON at line {error.lineno}: {error.msg}; mend the file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path.name}: can't be read as text: {error}") from error


def inside(root: Path, text: Any, source: str) -> Path:
    """The path that a file of the scene names, which must lie in the scene's folder. `source` names that file.

    An uploaded scene must not be able to make MGSR read the machine's other files.
    """
    if not isinstance(text, str) or not text.strip():
        raise SceneError(f"{source}: expected the path of an image, got {text!r}")
    path = Path(os.path.normpath(root / text.replace("\\", "/")))
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
    """The mask of an image in `root`/masks: the same name with .png or .jpg in place of, or after, its extension.

    The image's folders below the folder of all images count where masks/ has them too (``masks/left/0001.png``).
    """
    parts = image.relative_to(root).parts
    for first in range(len(parts)):
        place = root.joinpath("masks", *parts[first:-1])
        for name in (image.stem, image.name):
            for suffix in MASK_SUFFIXES:
                if (mask := place / (name + suffix)).is_file():
                    return mask
    return None


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
