"""COLMAP: a sparse model, binary or text, in sparse/0 or sparse, and the photographs in images/.

The folder layouts of other programs are read too.

COLMAP's documentation, "Output Format", describes the files. Newer models also have files of rigs and frames. They are
not read, because the images file still holds the pose of every photograph.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import is_photo, text_number
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, AnyLens, AriaLens, DivisionLens, FieldOfViewLens, Lens, UnifiedLens
from mgsr.data.odd_files import require_content
from mgsr.data.photo_files import FoundPhotos, SceneFolder
from mgsr.data.poses import intrinsics
from mgsr.data.registration import check_share
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError, in_short

_Content = TypeVar("_Content")

# Folders of models, numbered or single, with the folders that may hold their photographs. ns-process-data writes
# colmap/sparse. The convert.py of 3D Gaussian Splatting writes distorted/sparse, and undistorts input/ into images/.
_PLACES = {
    "sparse": ("images", "input", "."),
    "colmap/sparse": ("images", "input", "."),
    "distorted/sparse": ("input", "images", "."),
    ".": ("images", "input", "."),
}

# If COLMAP registered less than this share of the photographs, its model is not of the whole scene.
_LEAST_REGISTERED = 0.25

# By their numbers in binary files: the camera models' names and parameter counts. `to_pinhole` reads the parameters.
_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}

# Models with a single focal length begin with f, cx, cy; all others begin with fx, fy, cx, cy.
_ONE_FOCAL = {
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_DIVISION",
    "SIMPLE_FISHEYE",
}


@dataclass(frozen=True)
class ColmapCamera:
    """A camera of a COLMAP model.

    model: the name of its camera model. width, height: the size of its images in pixels. params: the parameters, in
    COLMAP's order.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class _ColmapImage:
    name: str
    quat: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int


@dataclass(frozen=True)
class _ColmapModel:
    """A sparse model. marker: the model's images file. where: the model's folder, for messages."""

    marker: Path
    where: str
    images: list[_ColmapImage]


def recognises(root: Path) -> str | None:
    """Return the images file of the first model, or None."""
    _, markers = _find_models(root)
    return str(markers[0].relative_to(root)) if markers else None


def read(folder: SceneFolder) -> Capture:
    """Read every registered image and every 3D point of the model with the most images."""
    place, markers = _find_models(folder.root)
    models = [_read_images(folder.root, marker) for marker in markers]
    model = max(models, key=lambda candidate: len(candidate.images))
    cameras, points = _read_scene(model)
    file = f"{model.where}/{model.marker.name}"
    found = folder.find_photos(file, [image.name for image in model.images], _PLACES[place])
    capture = Capture.of(found, lambda i, path: _photo(path, model.images[i], cameras, file))
    notes = (*_other_models(models, model), *capture.notes, *_left_out(found, model))
    return replace(capture, points=points, notes=notes)


def read_model(model_folder: Path, photos: SceneFolder) -> Capture:
    """Read every registered image and every 3D point of a model whose photographs lie in another folder.

    Raises SceneError if the model is missing or damaged.
    """
    marker = _marker(model_folder)
    if marker is None:
        raise SceneError(f"{model_folder.name}: there is no images.bin or images.txt; find the cameras again")
    model = _read_images(model_folder.parent, marker)
    cameras, points = _read_scene(model)
    file = f"{model.where}/{marker.name}"
    found = photos.find_photos(file, [image.name for image in model.images])
    return replace(Capture.of(found, lambda i, path: _photo(path, model.images[i], cameras, file)), points=points)


def _find_models(root: Path) -> tuple[str, list[Path]]:
    """Return the first of _PLACES that has models, and their images files.

    Models beside a transforms.json are ignored, because that file derives from them and adds masks and splits.
    """
    if (root / "transforms.json").is_file():
        return "", []
    for place in _PLACES:
        numbered = sorted((root / place).glob("[0-9]*"), key=lambda path: (len(path.name), path.name))
        folders = [*numbered, root / place] if place != "." else [path for path in (*numbered, root) if _is_model(path)]
        if markers := [marker for folder in folders if (marker := _marker(folder))]:
            return place, markers
    return "", []


def _marker(folder: Path) -> Path | None:
    """Return the images file of the model in a folder, or None."""
    found = (folder / ("images" + suffix) for suffix in _IMAGES)
    return next((path for path in found if path.is_file()), None)


def _is_model(folder: Path) -> bool:
    """Return whether a folder has a cameras file; without one, its images file may be another program's list."""
    return any((folder / ("cameras" + suffix)).is_file() for suffix in _CAMERAS)


def _read_images(root: Path, marker: Path) -> _ColmapModel:
    where = marker.parent.relative_to(root).as_posix() if marker.parent != root else root.name
    return _ColmapModel(marker, where, _parsed(_IMAGES, marker, where))


def _read_scene(model: _ColmapModel) -> tuple[dict[int, ColmapCamera], PointCloud | None]:
    """Return the cameras and points of a model. The points are None if it has no file of points."""
    cameras, points = model.marker.with_stem("cameras"), model.marker.with_stem("points3D")
    return (
        _parsed(_CAMERAS, cameras, model.where),
        _parsed(_POINTS, points, model.where) if points.is_file() else None,
    )


def _parsed(parsers: Mapping[str, Callable[[Path], _Content]], path: Path, where: str) -> _Content:
    """Parse a model's file, binary or text. Raises SceneError if it is missing or damaged."""
    if parsers is not _POINTS:  # a model made from known poses may have an empty file of points
        require_content(path)
    try:
        return parsers[path.suffix](path)
    except FileNotFoundError as error:
        raise SceneError(f"{where}: the COLMAP model lacks {path.name}; copy the file there") from error
    except (struct.error, OSError, ValueError, IndexError, KeyError, OverflowError) as error:
        raise SceneError(f"{where}/{path.name}: damaged COLMAP model: {in_short(error)}; export it again") from error


def _other_models(models: Sequence[_ColmapModel], used: _ColmapModel) -> tuple[str, ...]:
    others = ", ".join(f"{model.where} has {len(model.images)}" for model in models if model is not used)
    return (f"the model {used.where} with {len(used.images)} photographs is used; {others}",) if others else ()


def _left_out(found: FoundPhotos, model: _ColmapModel) -> tuple[str, ...]:
    """Return a note on the photographs that COLMAP did not register. Raises SceneError if it registered few."""
    folders = {path.parent for path in found.files}
    there = {path for folder in folders for path in folder.iterdir() if is_photo(path)}
    registered = len(model.images)
    total = max(registered, registered + len(there - set(found.files)))
    cure = "register more photographs, or remove the others from the folder"
    return check_share(registered, total, _LEAST_REGISTERED, f"are registered in {model.where}", cure)


def _photo(path: Path, image: _ColmapImage, cameras: dict[int, ColmapCamera], file: str) -> Photo:
    source = f"{file}, image {image.name}"
    if image.camera not in cameras:
        raise SceneError(f"{source}: camera {image.camera} is not in the cameras file")
    camera = cameras[image.camera]
    K, lens = to_pinhole(camera, source)
    size = (camera.width, camera.height)
    return Photo(image=path, K=K, size=size, cam_from_world=_pose(image, source), source=source, lens=lens)


def to_pinhole(camera: ColmapCamera, source: str) -> tuple[np.ndarray, AnyLens | None]:
    """Return the intrinsics [3,3] in pixels, and the lens whose distortion must be removed, None for a pinhole.

    COLMAP's sensor/models.h defines the models. source: the camera's place in the capture, for messages. Raises
    SceneError for panoramas, for other unsupported models, and for parameters that are not finite.
    """
    if camera.model.lower() in PANORAMAS:
        raise SceneError(f"{source}: camera model {camera.model} is not supported: {PANORAMA_CURE}")
    if camera.model not in dict(_MODELS.values()):
        raise SceneError(
            f"{source}: camera model {camera.model} is not supported; run `colmap image_undistorter` and use its output"
        )
    if not np.isfinite(camera.params).all():
        raise SceneError(f"{source}: the camera has NaN or infinite numbers; export it again")
    if camera.model in _ONE_FOCAL:
        (f, cx, cy), terms = camera.params[:3], camera.params[3:]
        K = intrinsics(f, f, cx, cy)
    else:
        K, terms = intrinsics(*camera.params[:4]), camera.params[4:]
    lens = _lens(camera.model, terms)
    return K, None if lens is None or lens.flat else lens


def _lens(model: str, terms: tuple[float, ...]) -> AnyLens | None:
    p = (*terms, *[0.0] * (12 - len(terms)))
    match model:
        case "SIMPLE_RADIAL" | "RADIAL" | "OPENCV":
            return Lens(p[0], p[1], p[2], p[3])
        case "FULL_OPENCV":
            return Lens(p[0], p[1], p[2], p[3], higher=p[4:5], divisor=p[5:8])
        case "OPENCV_FISHEYE":
            return Lens(p[0], p[1], higher=p[2:4], fisheye=True)
        case "SIMPLE_FISHEYE" | "FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE":
            return Lens(p[0], p[1], fisheye=True)
        case "THIN_PRISM_FISHEYE":
            return Lens(p[0], p[1], p[2], p[3], higher=p[4:6], prism=(p[6], 0.0, p[7], 0.0), fisheye=True)
        case "RAD_TAN_THIN_PRISM_FISHEYE":
            return AriaLens(p[:6], (p[6], p[7]), (p[8], p[9], p[10], p[11]))
        case "SIMPLE_DIVISION" | "DIVISION":
            return DivisionLens(p[0])
        case "FOV":
            return FieldOfViewLens(p[0]) if p[0] else None
        case "EUCM":
            return UnifiedLens(p[0], p[1])
    return None


def _pose(image: _ColmapImage, source: str) -> np.ndarray:
    """Return cam_from_world [4,4] from COLMAP's quaternion (wxyz) and translation.

    Raises SceneError for a zero quaternion.
    """
    norm = np.linalg.norm(image.quat)
    if not np.isfinite(norm) or norm == 0:
        raise SceneError(f"{source}: the pose has the invalid quaternion {list(image.quat)}; fix it or remove the view")
    w, x, y, z = np.array(image.quat) / norm
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = image.translation
    return pose


# Text files have one record per line, but an image has two lines. The second holds its 2D points (x, y, number) and may
# be empty. Files of other programs may lack it.


_NUMBERS = re.compile(r"(?:[-+.\deE\s]|-?nan(?:\(\w*\))?)+", re.IGNORECASE)


def _text_lines(path: Path) -> list[str]:
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    return [line.strip() for line in lines if not line.startswith("#")]


def _text_cameras(path: Path) -> dict[int, ColmapCamera]:
    rows = [line.split() for line in _text_lines(path) if line]
    return {
        int(row[0]): checked_camera(row[1], int(row[2]), int(row[3]), tuple(map(text_number, row[4:]))) for row in rows
    }


def _text_images(path: Path) -> list[_ColmapImage]:
    images: list[_ColmapImage] = []
    may_be_points = False
    for line in _text_lines(path):
        is_image = bool(line) and not (may_be_points and _is_points(line))
        if is_image:
            row = line.split(maxsplit=9)
            numbers = tuple(map(text_number, row[1:8]))
            images.append(_ColmapImage(row[9], numbers[:4], numbers[4:], int(row[8])))
        may_be_points = is_image
    return images


def _is_points(line: str) -> bool:
    """Return whether a line consists of triples of numbers.

    The line of an image has ten fields, so it does not, even if the image's name is a number.
    """
    return _NUMBERS.fullmatch(line) is not None and len(line.split()) % 3 == 0


def _text_points(path: Path) -> PointCloud:
    rows = [line.split(maxsplit=7)[1:7] for line in _text_lines(path) if line]
    table = np.array([[text_number(word) for word in row] for row in rows]).reshape(-1, 6)
    table = table[np.isfinite(table).all(axis=1)]
    return PointCloud(table[:, :3], table[:, 3:].astype(np.uint8))


# Binary files are little-endian: a 64-bit count, then the records.


class _ByteReader:
    """A reader that takes values from a file's bytes, from front to back."""

    def __init__(self, path: Path) -> None:
        self.data, self.at = path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.skip(struct.calcsize("<" + layout))
        return values

    def skip(self, count: int) -> None:
        """Move on by `count` bytes. Raises ValueError at the end of the file."""
        self.at += count
        if self.at > len(self.data):
            raise ValueError("the file is truncated")

    def take_text(self) -> str:
        end = self.data.index(b"\0", self.at)
        text = self.data[self.at : end].decode("utf-8")
        self.at = end + 1
        return text

    def records(self) -> Iterator[int]:
        yield from range(self.take("Q")[0])


def _binary_cameras(path: Path) -> dict[int, ColmapCamera]:
    data, cameras = _ByteReader(path), {}
    for _ in data.records():
        number, kind, width, height = data.take("IiQQ")
        model, count = _MODELS[kind]
        cameras[number] = checked_camera(model, width, height, data.take(f"{count}d"))
    return cameras


def _binary_images(path: Path) -> list[_ColmapImage]:
    data, images = _ByteReader(path), []
    for _ in data.records():
        numbers = data.take("I7dI")
        images.append(_ColmapImage(data.take_text(), numbers[1:5], numbers[5:8], numbers[8]))
        data.skip(24 * data.take("Q")[0])
    return images


def _binary_points(path: Path) -> PointCloud:
    data, positions, colors = _ByteReader(path), [], []
    for _ in data.records():
        record = data.take("Q3d3BdQ")
        positions.append(record[1:4])
        colors.append(record[4:7])
        data.skip(8 * record[8])
    places = np.array(positions, np.float64).reshape(-1, 3)
    finite = np.isfinite(places).all(axis=1)
    return PointCloud(places[finite], np.array(colors, np.uint8).reshape(-1, 3)[finite])


def checked_camera(model: str, width: int, height: int, params: tuple[float, ...]) -> ColmapCamera:
    """Return a camera after checking the number of its parameters.

    Raises ValueError if a known model has another number of parameters. Unknown models pass, because `to_pinhole`
    refuses them.
    """
    count = dict(_MODELS.values()).get(model)
    if count is not None and len(params) != count:
        raise ValueError(f"camera model {model}: expected {count} parameters, got {len(params)}")
    return ColmapCamera(model, width, height, params)


_CAMERAS = {".bin": _binary_cameras, ".txt": _text_cameras}
_IMAGES = {".bin": _binary_images, ".txt": _text_images}
_POINTS = {".bin": _binary_points, ".txt": _text_points}

FORMAT = Format(
    "colmap", "sparse/0 or sparse with images.bin or images.txt, and images/ (COLMAP)", recognises, read, rank=30
)
