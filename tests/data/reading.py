"""What tests of single readers share: a folder read by the format that recognises it, without loading its images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from mgsr.data.capture import Capture, Photo
from mgsr.data.formats import all_formats
from mgsr.data.photo_files import SceneFolder


def read_capture(root: Path, name: str) -> Capture:
    """Read the capture in `root`, which must be recognised as the format of that name before all others."""
    kind = next(kind for kind in all_formats() if kind.recognises(root))
    assert kind.name == name
    return kind.read(SceneFolder.at(root))


def read_strictly(root: Path, name: str) -> Capture:
    """Read the capture in `root`; raise the reason of the first photograph that can't be used."""
    capture = read_capture(root, name)
    if capture.lost:
        raise capture.lost[0]
    return capture


def draw(path: Path, width: int = 64, height: int = 64) -> None:
    """Write a small black picture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.zeros((height, width, 3), np.uint8)).save(path)


def project(photo: Photo, points: np.ndarray) -> np.ndarray:
    """Return pixels [P,2] of world points [P,3] as a photograph's reader describes its camera, lens included."""
    local = points @ photo.cam_from_world[:3, :3].T + photo.cam_from_world[:3, 3]
    x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    if photo.lens is not None:
        x, y = photo.lens.distort(x, y)
    pixels: np.ndarray = np.stack([x, y], axis=1) @ photo.K[:2, :2].T + photo.K[:2, 2]
    return pixels
