"""Which file is a photograph's mask, told by its name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

from mgsr.data.files import IMAGE_SUFFIXES, MASK_FOLDERS, all_images, folded


class MaskIndex:
    """The masks of the photographs in `root`: in root/masks or root/mask, or beside the photograph as RealityCapture
    has it.

    In the folder: the photograph's name with an image's extension in place of, or after, its own, also with _mask or
    .mask before that, or mask_ at the front (``0001.png``, ``0001.jpg.png``, ``0001_mask.png``, ``0001.mask.png``,
    ``mask_0001.png``); beside it: ``0001.mask.png`` and ``0001.jpg.mask.png`` alone. The photograph's folders below the
    folder of all count where masks/ has them too (``masks/left/0001.png``). Letters may be large or small.
    """

    def __init__(self, root: Path) -> None:
        self._root = root

    @cached_property
    def folders(self) -> list[Path]:
        """The folders of masks."""
        inner = [path for path in self._root.iterdir() if path.name.lower() in MASK_FOLDERS and path.is_dir()]
        return sorted(inner, key=lambda path: (MASK_FOLDERS.index(path.name.lower()), path.name))

    @cached_property
    def masks(self) -> list[Path]:
        """All images in them."""
        return [path for folder in self.folders for path in all_images(folder)]

    def find(self, image: Path) -> Path | None:
        """The mask of the photograph `image`, whose path lies in the root; None if there is none."""
        marked = (image.stem + ".mask", image.name + ".mask")
        names = (image.stem, image.name, image.stem + "_mask", *marked, "mask_" + image.stem)
        parts = image.relative_to(self._root).parts
        for folder in self.folders:
            for first in range(len(parts)):
                place = folder.relative_to(self._root).joinpath(*parts[first:-1])
                if found := self._first(place, names, image):
                    return found
        return self._first(image.parent.relative_to(self._root), marked, image)

    def _first(self, place: Path, names: Sequence[str], image: Path) -> Path | None:
        keys = (folded(str(place / name)) for name in names)
        found = (self._by_name[key] for key in keys if key in self._by_name)
        return next((path for path in found if path != image), None)

    @cached_property
    def _by_name(self) -> dict[str, Path]:
        """Masks by their path in the root without extension; those that come first among the types of image first."""
        beside = [path for path in all_images(self._root) if path.stem.lower().endswith(".mask")]
        ordered = sorted([*self.masks, *beside], key=lambda path: IMAGE_SUFFIXES.index(path.suffix.lower()))
        return {folded(str(path.relative_to(self._root).with_suffix(""))): path for path in reversed(ordered)}
