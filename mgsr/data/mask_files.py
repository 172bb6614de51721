"""Find a photograph's mask by its file name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

from mgsr.data.files import IGNORED_PREFIX, IMAGE_SUFFIXES, MASK_FOLDERS, all_images, folded, is_mask_beside
from mgsr.data.photo_files import SceneFolder


class MaskIndex:
    """The masks of a scene's photographs, by file name.

    Masks lie in a folder masks/ or mask/, at the scene's root or in a folder of photographs, or beside the photograph
    as in RealityCapture.

    In such a folder a mask has the photograph's name, with an image extension in place of, or after, the photograph's
    own. The name may have _mask or .mask before that, or mask_ at the front (``0001.png``, ``0001.jpg.png``,
    ``0001_mask.png``, ``0001.mask.png``, ``mask_0001.png``). Beside the photograph, only ``0001.mask.png`` and
    ``0001.jpg.mask.png`` count. Subfolders of the photographs' folder count where masks/ has them too
    (``masks/left/0001.png``). Case does not matter.
    """

    def __init__(self, folder: SceneFolder) -> None:
        self._folder = folder
        self._listed: dict[Path, dict[str, Path]] = {}
        self._inner: dict[Path, list[Path]] = {}

    @cached_property
    def masks(self) -> list[Path]:
        """Return all images in the scene's own mask folders."""
        homes = dict.fromkeys((self._folder.root, self._folder.top))
        return [path for home in homes for folder in self._mask_folders(home) for path in all_images(folder)]

    def find(self, image: Path) -> Path | None:
        """Return the mask of the photograph `image`, whose path lies below the scene's top; None if there is none."""
        marked = (image.stem + ".mask", image.name + ".mask")
        names = (image.stem, image.name, image.stem + "_mask", *marked, "mask_" + image.stem)
        for home in self._homes(image):
            parts = image.relative_to(home).parts
            for folder in self._mask_folders(home):
                places = (Path(*parts[first:-1]) for first in range(len(parts)))
                found = next((path for place in places if (path := self._first(folder, place, names))), None)
                if found is not None:
                    return found
        return self._beside(image, marked)

    def find_ignored(self, image: Path) -> Path | None:
        """Return instant-ngp's dynamic_mask_NAME.png beside the photograph `image`, or None."""
        return self._beside(image, (IGNORED_PREFIX + image.stem,))

    def _homes(self, image: Path) -> list[Path]:
        """Return the folders that may hold a mask folder for a photograph: the root, and the photograph's parents."""
        root = [self._folder.root] if image.is_relative_to(self._folder.root) else []
        return [*root, *(path for path in image.parents if path.is_relative_to(self._folder.top) and path not in root)]

    def _mask_folders(self, home: Path) -> list[Path]:
        """Return the mask folders in a folder, masks/ first; the result is cached."""
        if home not in self._inner:
            inner = [path for path in home.iterdir() if path.name.lower() in MASK_FOLDERS and path.is_dir()]
            self._inner[home] = sorted(inner, key=lambda path: (MASK_FOLDERS.index(path.name.lower()), path.name))
        return self._inner[home]

    def _beside(self, image: Path, names: Sequence[str]) -> Path | None:
        if image.parent not in self._listed:
            images = [path for path in image.parent.iterdir() if is_mask_beside(path)]
            self._listed[image.parent] = _by_name(image.parent, images)
        return self._first(image.parent, Path(), names)

    def _first(self, folder: Path, place: Path, names: Sequence[str]) -> Path | None:
        """Return the first image at `place` in a folder with one of these names, without extension, or None."""
        if folder not in self._listed:
            self._listed[folder] = _by_name(folder, all_images(folder))
        there = self._listed[folder]
        return next((there[key] for name in names if (key := folded(str(place / name))) in there), None)


def _by_name(folder: Path, images: Sequence[Path]) -> dict[str, Path]:
    """Return images by their folded paths in a folder, without extension.

    Of two images with the same path, the one with the earlier extension in IMAGE_SUFFIXES wins.
    """
    known = [path for path in images if path.suffix.lower() in IMAGE_SUFFIXES]
    ordered = sorted(known, key=lambda path: IMAGE_SUFFIXES.index(path.suffix.lower()))
    return {folded(str(path.relative_to(folder).with_suffix(""))): path for path in reversed(ordered)}
