"""The result of a format reader: photographs as the files describe them, in the user's frame, not yet decoded.

A new format is one new file in `mgsr/data/formats/` with a constant ``FORMAT: Format``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from mgsr.data.lens import AnyLens
from mgsr.data.photo_files import FoundPhotos, SceneFolder
from mgsr.data.scene import PointCloud
from mgsr.errors import MissingPhotoError, SceneError


class Split(StrEnum):
    """The use of a photograph: training or test."""

    TRAIN = "train"
    TEST = "test"


@dataclass(frozen=True)
class Photo:
    """One photograph as the files of a capture describe it; loaded, it is a `View`.

    image: the image file.
    mask: a file that is white on the object, or black on the regions to ignore and white elsewhere (see `MaskUse`);
    None without a mask.
    ignored: a file that is white on the regions to ignore and black elsewhere, or None.
    K [3,3]: pixels, pixel centres at +0.5, for an image of `size` = (width, height). If the image has another size, K
    is scaled to it. With a lens, image and K are those of the distorted photograph.
    cam_from_world [4,4]: in the user's frame, OpenCV axes; a uniform scale is divided out when it is checked.
    split: None if the files name none.
    source: the camera's place in the files, for messages ("transforms_train.json, frame 3").
    """

    image: Path
    K: np.ndarray
    size: tuple[int, int]
    cam_from_world: np.ndarray
    source: str
    mask: Path | None = None
    ignored: Path | None = None
    split: Split | None = None
    lens: AnyLens | None = None


@dataclass(frozen=True)
class Capture:
    """A capture as its files describe it.

    photos: the usable photographs.
    points: points of the surface in the user's frame, if the files have them.
    notes: messages to the user about everything that the reader left out.
    file: the file that names the photographs, for messages.
    lost: the error of each photograph that is missing or whose camera can't be used.
    least_kept: the least share of usable photographs.
    """

    photos: list[Photo]
    points: PointCloud | None = None
    notes: tuple[str, ...] = ()
    file: str = "the scene's files"
    lost: tuple[SceneError, ...] = ()
    least_kept: float = 0.5

    @classmethod
    def of(cls, found: FoundPhotos, build: Callable[[int, Path], Photo]) -> Capture:
        """Build a capture from the photographs found for a list of names.

        build: builds the photograph at an index of the list of names. A SceneError that it raises excludes only that
        photograph.
        """
        photos: list[Photo] = []
        lost: list[SceneError] = []
        for number, path in enumerate(found.paths):
            try:
                photos.append(build(number, _there(path)))
            except SceneError as error:
                lost.append(error)
        return cls(photos, notes=found.notes, file=found.file, lost=tuple(lost))

    @property
    def missing(self) -> list[MissingPhotoError]:
        """Return the errors of the photographs that the files name but that are missing."""
        return [error for error in self.lost if isinstance(error, MissingPhotoError)]


def _there(path: Path | SceneError) -> Path:
    if isinstance(path, SceneError):
        raise path
    return path


@dataclass(frozen=True)
class Format:
    """One kind of input.

    name: a short name, for reports.
    looks_for: the files that identify the format, for the message that lists all formats.
    recognises: returns the file in a folder that identifies the format, or None. It must not raise.
    read: returns the capture of a recognised folder; raises SceneError. Poses and intrinsics are checked afterwards.
    rank: if several formats recognise a folder, the lowest rank wins.
    """

    name: str
    looks_for: str
    recognises: Callable[[Path], str | None]
    read: Callable[[SceneFolder], Capture]
    rank: int = 50
