"""LLFF: poses_bounds.npy, and photographs in the order of their names.

Source: the README of LLFF (Fyusion/LLFF), "Using your own poses without running COLMAP". Each row has a 3x5 matrix and
the bounds of depth. The matrix's last column holds height, width and focal length; the other columns are a
camera-to-world pose. The camera's axes are down, right, backwards. Its principal point is the centre of the image.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.npz import DAMAGE
from mgsr.data.number_files import LARGEST_CAPTURE, folders_in, photographs_in, read_lines
from mgsr.data.odd_files import is_video_name, require_content
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_world_from_cam, intrinsics, rigid
from mgsr.errors import SceneError, in_short

_FILE = "poses_bounds.npy"
_REGISTERED = "view_imgs.txt"
_COLUMNS = 17


def recognises(root: Path) -> str | None:
    """Return poses_bounds.npy if the folder has it."""
    return _FILE if (root / _FILE).is_file() else None


def read(folder: SceneFolder) -> Capture:
    """Read the pose of every photograph. Raises SceneError if there are more or fewer photographs than poses."""
    rows = _rows(folder.root / _FILE)
    found = folder.find_photos(_FILE, _names(folder, len(rows)))
    return Capture.of(found, lambda i, image: _photo(image, rows[i], f"{_FILE}, row {i}"))


def _rows(path: Path) -> np.ndarray:
    """Read the rows [N,17] of the file. Raises SceneError for damaged files and other shapes."""
    require_content(path)
    try:
        rows = _load(path)
    except DAMAGE as error:
        raise SceneError(f"{_FILE}: the file is damaged: {in_short(error)}; copy it again") from error
    if rows.ndim != 2 or rows.shape[1] != _COLUMNS or not len(rows):
        raise SceneError(
            f"{_FILE}: expected {_COLUMNS} numbers per camera, got an array of shape {list(rows.shape)}; write it with "
            "LLFF's imgs2poses.py"
        )
    return rows


def _load(path: Path) -> np.ndarray:
    """Load the array [...] of an .npy file (numpy.lib.format) after checking its declared size against the file's.

    Raises ValueError if the array is not numeric, or larger than the file.
    """
    with path.open("rb") as file:
        major, _ = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(file)
        size = dtype.itemsize * int(np.prod([float(side) for side in shape]))
        if dtype.kind not in "iuf" or not 0 <= size <= min(LARGEST_CAPTURE, path.stat().st_size):
            raise ValueError(f"expected an array of numbers, got {dtype} of shape {shape}")
        file.seek(0)
        values: np.ndarray = np.load(file, allow_pickle=False).astype(np.float64)
        return values


def _names(folder: SceneFolder, count: int) -> list[str]:
    """Return the photographs in the order of the poses.

    If view_imgs.txt lists as many photographs as there are poses, its names count. Some programs write it if COLMAP
    left photographs out. Otherwise the first folder with the right number of photographs counts. Raises SceneError if
    no folder fits.
    """
    listed = _listed(folder.root / _REGISTERED)
    if len(listed) == count:
        return listed
    places = [place for place in _places(folder) if photographs_in(place)]
    place = next((place for place in places if len(photographs_in(place)) == count), None)
    if place is None:
        raise SceneError(_mismatch(folder, count, places))
    return [str(path.relative_to(folder.root)) for path in photographs_in(place)]


def _listed(path: Path) -> list[str]:
    if not path.is_file():
        return []
    return sorted(line.strip() for line in read_lines(path, LARGEST_CAPTURE) if line.strip())


def _places(folder: SceneFolder) -> list[Path]:
    """Return the folders to search: images/, its reduced copies with the largest first, the root, and all others."""
    reduced = sorted(folder.root.glob("images_*"), key=lambda path: (len(path.name), path.name))
    others = [path for path in folders_in(folder.root) if path not in reduced and path.name != "images"]
    return [folder.root / "images", *reduced, folder.root, *others]


def _mismatch(folder: SceneFolder, count: int, places: list[Path]) -> str:
    if not places:
        videos = any(is_video_name(path) for path in folder.root.iterdir())
        cure = "extract one frame of each video to images/" if videos else "copy them to images/"
        return f"{_FILE}: it has {count} cameras, but there are no photographs; {cure}, in the order of the cameras"
    number = len(photographs_in(places[0]))
    return (
        f"{_FILE}: it has {count} cameras, but {folder.shown(places[0])} has {number} photographs; cameras follow the "
        f"order of the names, so keep only photographs with a camera, or list their names in {_REGISTERED}"
    )


def _photo(image: Path, row: np.ndarray, source: str) -> Photo:
    pose = row[:15].reshape(3, 5)
    height, width, focal = pose[:, 4]
    if not (1 <= height < 1e6 and 1 <= width < 1e6):
        raise SceneError(
            f"{source}: expected height, width and focal length of the image, got {width:g}x{height:g} pixels"
        )
    down, right, backwards = pose[:, :3].T
    world_from_cam = rigid(np.stack([right, down, -backwards], axis=1), pose[:, 3])
    size = round(float(width)), round(float(height))
    K = intrinsics(focal, focal, width / 2, height / 2)
    return Photo(image, K, size, from_world_from_cam(world_from_cam, source), source)


FORMAT = Format("llff", f"{_FILE} and photographs in images/ (LLFF)", recognises, read, rank=120)
