"""What a format hands over: photographs as the files describe them, in the user's frame, nothing decoded yet.

A new format is one new file in `mgsr/data/formats/` with a constant ``FORMAT: Format``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from mgsr.data.lens import AnyLens
from mgsr.data.scene import PointCloud


class Split(StrEnum):
    """What a photograph is used for."""

    TRAIN = "train"
    TEST = "test"


@dataclass(frozen=True)
class Photo:
    """One photograph.

    image: its file; mask: a file with the object white on black, or None.
    K: [3,3] pixels, pixel centres at +0.5, for an image of `size` = (width, height); it follows the image if that is
    larger or smaller. With a lens, image and K are those of the distorted photograph.
    cam_from_world: [4,4] in the user's frame, OpenCV axes.
    split: None where the files name none.
    source: where the camera stands, for messages ("transforms_train.json, frame 3").
    """

    image: Path
    K: np.ndarray
    size: tuple[int, int]
    cam_from_world: np.ndarray
    source: str
    mask: Path | None = None
    split: Split | None = None
    lens: AnyLens | None = None


@dataclass(frozen=True)
class Capture:
    """All photographs of a scene, points of its surface in the user's frame where the files have them, and notes for
    the person: what the files have and the reader left out."""

    photos: list[Photo]
    points: PointCloud | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """One kind of input.

    name: short, for reports. looks_for: what makes a folder this format, for the message that lists all formats.
    recognises: given a folder, the file that makes it this format, or None. It must not raise.
    read: the capture in a folder that was recognised; raises SceneError. Poses and intrinsics are checked afterwards.
    rank: where several formats recognise a folder, the lowest wins.
    """

    name: str
    looks_for: str
    recognises: Callable[[Path], str | None]
    read: Callable[[Path], Capture]
    rank: int = 50
