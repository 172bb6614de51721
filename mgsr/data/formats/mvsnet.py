"""MVSNet's camera files, cams/00000000_cam.txt, which BlendedMVS, DTU and Tanks and Temples have too.

Source: the README of MVSNet (YoYo000/MVSNet), "File Formats". The extrinsic matrix maps the world to the camera, with
OpenCV's axes. Pixel centres are at +0.5, as in MVSNet's homography warping.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import images_below
from mgsr.data.images import image_size
from mgsr.data.number_files import calibrated_size, head_of, read_lines, row_from, texts_in
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import matrix_from, pose_from
from mgsr.errors import SceneError

_FOLDERS = ("cams", "cams_1", "Cameras", "Cameras/train", "cameras")
_PLACES = ("blended_images", "images", "image", "images_post", ".")
_DTU = re.compile(r"rect_\d{3}_(\d|max)_r5000")


def recognises(root: Path) -> str | None:
    """Return the first camera file if it begins like MVSNet's."""
    files = _cameras(root)
    return files[0].relative_to(root).as_posix() if files else None


def _cameras(root: Path) -> list[Path]:
    """Return the camera files of the first folder that has any."""
    for name in _FOLDERS:
        files = texts_in(root / name, "*_cam.txt")
        if files and head_of(files[0], 64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"extrinsic"):
            return files
    return []


def read(folder: SceneFolder) -> Capture:
    """Read every camera file that has a photograph of the same number.

    BlendedMVS also has photographs with the backdrop masked out, under other names; these are not used.
    """
    files = _cameras(folder.root)
    names = _names(folder.root, [path.name.removesuffix("_cam.txt") for path in files])
    found = folder.find_photos(files[0].parent.relative_to(folder.root).as_posix(), names, _PLACES, labels=True)
    return Capture.of(found, lambda i, image: _photo(folder, image, files[i]))


def _names(root: Path, numbers: list[str]) -> list[str]:
    """Return the photographs' names: the cameras' numbers.

    In the original DTU layout, number 0 is rect_001_3_r5000. The layout has seven lights; as is usual, the fourth (3)
    is used.
    """
    lights = {match[1] for path in images_below(root) if (match := _DTU.fullmatch(path.stem))}
    if not lights or not all(number.isdecimal() and len(number) < 10 for number in numbers):
        return numbers
    light = "3" if "3" in lights else max(lights)
    return [f"rect_{int(number) + 1:03d}_{light}_r5000" for number in numbers]


def _photo(folder: SceneFolder, image: Path, file: Path) -> Photo:
    source = file.relative_to(folder.root).as_posix()
    extrinsic, K = _matrices(file, source)
    return Photo(image, K, calibrated_size(K, image_size(image, source)), extrinsic, source)


def _matrices(file: Path, source: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the extrinsic [4,4] and the intrinsic [3,3] matrix. Raises SceneError if one is missing or damaged."""
    lines = [line.strip() for line in read_lines(file)]
    extrinsic, intrinsic = _part(lines, "extrinsic", 4, source), _part(lines, "intrinsic", 3, source)
    return pose_from(extrinsic, "extrinsic", source), matrix_from(intrinsic, 3, 3, "intrinsic", source)


def _part(lines: list[str], title: str, count: int, source: str) -> list[list[float]]:
    """Return the `count` rows of numbers after the line `title`. Raises SceneError if there is no such line."""
    if title not in lines:
        raise SceneError(f"{source}: expected a line {title!r} and {count} rows of numbers after it; fix the file")
    start = lines.index(title) + 1
    return [row_from(line, source) for line in lines[start : start + count]]


FORMAT = Format("mvsnet", "cams/00000000_cam.txt (MVSNet, BlendedMVS, DTU)", recognises, read, rank=110)
