"""Refuse images that are too large to decode in memory."""

from __future__ import annotations

from pathlib import Path

from mgsr.data.files import IMAGE_SUFFIXES
from mgsr.data.images import image_size
from mgsr.errors import ArchiveError


def check_images(folder: Path, most: int) -> None:
    """Check the headers of all images below `folder`. Raises ArchiveError for one with more pixels than `most`."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in IMAGE_SUFFIXES or not path.is_file():
            continue
        name = path.relative_to(folder).as_posix()
        width, height = image_size(path, "the archive")
        if width * height > most:
            text = f"image {name}: {width}x{height} pixels exceed the limit of {most} in one image; reduce it"
            raise ArchiveError("image_too_large", text)
