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

    image: its file. mask: a file that is white on the object, or black on the regions to ignore and white elsewhere
    (see `MaskUse`), or None. ignored: a file that is white on the regions to ignore and black elsewhere, or None.
    K: [3,3] pixels, pixel centres at +0.5, for an image of `size` = (width, height); it follows the image if that is
    larger or smaller. With a lens, image and K are those of the distorted photograph.
    cam_from_world: [4,4] in the user's frame, OpenCV axes; a uniform scale is divided out when it is checked.
    split: None where the files name none.
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

    photos: the usable photographs. points: points of the surface in the user's frame, where the files have them. notes:
    messages to the user about everything that the reader left out. file: the file that names the photographs, for
    messages.
    lost: the reason for each photograph that is missing or whose camera can't be used. least_kept: the share of the
    photographs that must be left.
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

    name: short, for reports. looks_for: what makes a folder this format, for the message that lists all formats.
    recognises: given a folder, the file in it that makes it this format, or None. It must not raise.
    read: the capture of a folder that was recognised; raises SceneError. Poses and intrinsics are checked afterwards.
    rank: where several formats recognise a folder, the lowest wins.
    """

    name: str
    looks_for: str
    recognises: Callable[[Path], str | None]
    read: Callable[[SceneFolder], Capture]
    rank: int = 50
