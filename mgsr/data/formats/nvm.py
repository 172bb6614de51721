"""VisualSFM: an .nvm file and the photographs.

Source: VisualSFM's documentation, "NVM format", and the sources of its multicore bundle adjustment (Wu 2011), which
read and write it. Cameras have OpenCV's axes. The principal point is the middle of the image unless the file has a
fixed calibration. The radial term r acts on measured points: undistorted = distorted (1 + r d^2). Here d is the length
of the distorted point, and both points are relative to the focal length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.images import image_size
from mgsr.data.lens import InverseRadialLens
from mgsr.data.number_lists import from_center, numbers, point_cloud, rotation_of
from mgsr.data.odd_files import require_content
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics, rigid
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError, in_short

# The number of words after a photograph's name: focal length, quaternion and centre (or rotation matrix and
# translation), radial term, a zero.
_WORDS = {"NVM_V3": 10, "NVM_V3_R9T": 15}


def recognises(root: Path) -> str | None:
    """Return the folder's first .nvm file with the header of the format."""
    return next((path.name for path in sorted(root.glob("[!.]*.nvm")) if _version(path)), None)


def read(folder: SceneFolder) -> Capture:
    """Read the photographs and points of the model with the most photographs. Raises SceneError if all are empty."""
    file = recognises(folder.root)
    assert file is not None, "read() accepts recognised folders only"
    content = _content(folder.root / file)
    model = max(content.models, key=lambda candidate: len(candidate.cameras), default=_NvmModel([], None))
    if not model.cameras:
        raise SceneError(f"{file}: it lists no photographs; reconstruct in VisualSFM and save it again")
    found = folder.find_photos(file, [camera.name for camera in model.cameras])
    capture = Capture.of(
        found, lambda i, path: _photo(path, model.cameras[i], content, f"{file}, {model.cameras[i].name[:80]}")
    )
    return replace(capture, points=model.points, notes=(*capture.notes, *_other_models(content.models, model, file)))


@dataclass(frozen=True)
class _NvmCamera:
    """A photograph's name, and its numbers as words."""

    name: str
    words: list[str]


@dataclass(frozen=True)
class _NvmModel:
    cameras: list[_NvmCamera]
    points: PointCloud | None


@dataclass(frozen=True)
class _Content:
    """The content of an NVM file. calibration: the fixed fx, cx, fy, cy of all photographs as words, or None."""

    version: str
    calibration: list[str] | None
    models: list[_NvmModel]


def _version(path: Path) -> str | None:
    """Return the version of an NVM file if MGSR reads it, else None."""
    try:
        with path.open("rb") as file:
            head = file.read(100).removeprefix(b"\xef\xbb\xbf").split()
    except OSError:
        return None
    version = head[0].decode("ascii", "replace") if head else ""
    return version if version in _WORDS else None


def _content(path: Path) -> _Content:
    require_content(path)
    try:
        with path.open(encoding="utf-8-sig") as file:
            lines = _lines(file)
            version, *rest = next(lines).split()
            line = next(lines, "0")
            if line.startswith("FixedK"):
                rest, line = line.split(), next(lines, "0")
            calibration = rest[1:5] if rest and rest[0] == "FixedK" else None
            return _Content(version, calibration, list(_models(line, lines, version)))
    except (OSError, ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"{path.name}: damaged NVM file: {in_short(error)}; save it again") from error


def _lines(file: Iterable[str]) -> Iterator[str]:
    return (line for line in map(str.strip, file) if line and not line.startswith("#"))


def _next(lines: Iterator[str]) -> str:
    line = next(lines, None)
    if line is None:
        raise ValueError("the file is truncated")
    return line


def _models(line: str, lines: Iterator[str], version: str) -> Iterator[_NvmModel]:
    """Yield the models up to a count of zero photographs, or the end of the file."""
    while (count := int(line.split()[0])) > 0:
        cameras = [_camera(_next(lines), version) for _ in range(count)]
        points = int(next(lines, "0").split()[0])
        yield _NvmModel(cameras, _points([_next(lines) for _ in range(points)]))
        line = next(lines, "0")


def _camera(line: str, version: str) -> _NvmCamera:
    """Parse a photograph's line. Raises ValueError if numbers are missing.

    VisualSFM replaces blanks in names by quotes. Some programs omit the final zero.
    """
    words = _WORDS[version]
    parts = line.rsplit(maxsplit=words)
    if len(parts) <= words:
        parts = [*line.rsplit(maxsplit=words - 1), "0"]
    if len(parts) <= words:
        raise ValueError(f"expected a photograph's name and {words} numbers, got {line[:80]!r}")
    return _NvmCamera(parts[0].strip('"').replace('"', " "), parts[1:])


def _points(lines: list[str]) -> PointCloud | None:
    rows = [line.split(maxsplit=6) for line in lines]
    return point_cloud([row[:3] for row in rows], [row[3:6] for row in rows])


def _other_models(models: list[_NvmModel], used: _NvmModel, file: str) -> tuple[str, ...]:
    others = [str(len(model.cameras)) for model in models if model is not used]
    if not others:
        return ()
    return (
        f"the largest model of {file} with {len(used.cameras)} photographs is used; the others have "
        f"{', '.join(others)}",
    )


def _photo(image: Path, camera: _NvmCamera, content: _Content, source: str) -> Photo:
    values = numbers(camera.words, _WORDS[content.version], "the camera", source)
    size = image_size(image, source)
    fx, cx, fy, cy = values[0], size[0] / 2, values[0], size[1] / 2
    if content.calibration is not None:
        fx, cx, fy, cy = numbers(content.calibration, 4, "FixedK", source)
    lens = InverseRadialLens(float(values[-2]))
    return Photo(
        image=image,
        K=intrinsics(fx, fy, cx, cy),
        size=size,
        cam_from_world=_pose(values[1:-2], source),
        source=source,
        lens=None if lens.flat else lens,
    )


def _pose(values: np.ndarray, source: str) -> np.ndarray:
    """Return cam_from_world [4,4] from a quaternion and the camera's centre, or from a rotation and a translation.

    values: [7] or [12], as the file has them.
    """
    if len(values) == 12:
        return rigid(values[:9].reshape(3, 3), values[9:])
    return from_center(rotation_of(values[:4], source), values[4:])


FORMAT = Format("nvm", "an .nvm that begins with NVM_V3 (VisualSFM)", recognises, read, rank=120)
