"""NeRO's glossy synthetic scenes: 0-camera.pkl beside 0.png.

Source: NeRO (liuyuan-pal/NeRO), dataset/database.py, GlossySyntheticDatabase. A file is a pickled pair: a pose [3,4]
from the world to the camera, with OpenCV's axes, and K [3,3]. Pixel centres are at +0.5 (network/renderer.py).
"""

from __future__ import annotations

import re
from pathlib import Path

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.images import image_size
from mgsr.data.number_files import calibrated_size
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import matrix_from, pose_from
from mgsr.data.safe_pickle import read_pickled_arrays
from mgsr.errors import SceneError

_SUFFIX = "-camera.pkl"


def recognises(root: Path) -> str | None:
    """Return the first camera file, or None."""
    files = _cameras(root)
    return files[0].name if files else None


def _cameras(root: Path) -> list[Path]:
    """Return the camera files, ordered by number."""
    files = [path for path in root.glob(f"*{_SUFFIX}") if re.fullmatch(r"\d{1,9}", _number(path))]
    return sorted(files, key=lambda path: int(_number(path)))


def _number(path: Path) -> str:
    return path.name.removesuffix(_SUFFIX)


def read(folder: SceneFolder) -> Capture:
    """Read every camera that has a photograph of the same number."""
    files = _cameras(folder.root)
    found = folder.find_photos(f"*{_SUFFIX}", [f"{_number(path)}.png" for path in files])
    return Capture.of(found, lambda i, image: _photo(image, files[i]))


def _photo(image: Path, file: Path) -> Photo:
    source = file.name
    arrays = read_pickled_arrays(file, source)
    if len(arrays) != 2:
        raise SceneError(f"{source}: expected a pose and intrinsics, got {len(arrays)} arrays; copy it again")
    K = matrix_from(arrays[1], 3, 3, "intrinsics", source)
    return Photo(image, K, calibrated_size(K, image_size(image, source)), pose_from(arrays[0], "pose", source), source)


FORMAT = Format("nero", f"0{_SUFFIX} beside 0.png (NeRO's glossy scenes)", recognises, read, rank=140)
