"""Pix4D: the file ..._calibrated_camera_parameters.txt of its params folder, and the photographs.

Source: Pix4D's knowledge base, "What does the Output Params Folder contain?" and "How are the Internal and External
Camera Parameters defined?". Each photograph has ten lines: its name and size; K; three radial and two tangential terms
as in OpenCV; the camera's position; the rotation from the world to OpenCV's camera axes. The image spans 0 to its
width.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.lens import Lens
from mgsr.data.number_lists import from_center, numbers
from mgsr.data.odd_files import require_content
from mgsr.data.photo_files import SceneFolder
from mgsr.errors import SceneError, in_short

_HEAD = "filename imagewidth imageheight"
_END_OF_HEAD = "camera model m = k [r|-rt] x"
_LINES = 10


def recognises(root: Path) -> str | None:
    """Return the folder's first .txt file that begins like Pix4D's list of calibrated cameras."""
    return next((path.name for path in sorted(root.glob("[!.]*.txt")) if _is_list(path)), None)


def read(folder: SceneFolder) -> Capture:
    """Read every camera in the project's frame, whose origin Pix4D writes to ..._offset.xyz."""
    file = recognises(folder.root)
    assert file is not None, "read() accepts recognised folders only"
    cameras = _cameras(folder.root / file)
    found = folder.find_photos(file, [camera.name for camera in cameras], labels=True)
    capture = Capture.of(found, lambda i, path: _photo(path, cameras[i], f"{file}, {cameras[i].name[:200]}"))
    return replace(capture, least_kept=0.25)


@dataclass(frozen=True)
class _Pix4dCamera:
    """A photograph's name, and its camera's lines: size, K (3), radial, tangential, position, rotation (3)."""

    name: str
    lines: list[str]


def _is_list(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(200).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    except OSError:
        return False
    return " ".join(head.lower().split()).startswith(_HEAD)


def _cameras(path: Path) -> list[_Pix4dCamera]:
    require_content(path)
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise SceneError(f"{path.name}: this file is not text: {in_short(error)}; process the project again") from error
    ends = [i for i, line in enumerate(lines[:20]) if " ".join(line.lower().split()) == _END_OF_HEAD]
    rows = lines[ends[0] + 1 :] if ends else []
    if not rows or len(rows) % _LINES:
        raise SceneError(
            f"{path.name}: expected {_LINES} lines per photograph after the header, got {len(rows)} lines in all; "
            "copy the file again, or process the project again"
        )
    return [_camera(rows[i : i + _LINES], path.name) for i in range(0, len(rows), _LINES)]


def _camera(lines: list[str], file: str) -> _Pix4dCamera:
    parts = lines[0].rsplit(maxsplit=2)
    if len(parts) < 3:
        raise SceneError(
            f"{file}: expected a photograph's name, width and height, got {lines[0][:80]!r}; copy it again"
        )
    return _Pix4dCamera(parts[0], [" ".join(parts[1:]), *lines[1:]])


def _photo(image: Path, camera: _Pix4dCamera, source: str) -> Photo:
    lines = camera.lines
    width, height = numbers(lines[0], 2, "width and height", source)
    K = numbers(" ".join(lines[1:4]), 9, "camera matrix", source).reshape(3, 3)
    k1, k2, k3 = numbers(lines[4], 3, "radial distortion", source).tolist()
    p1, p2 = numbers(lines[5], 2, "tangential distortion", source).tolist()
    center = numbers(lines[6], 3, "camera position", source)
    rotation = numbers(" ".join(lines[7:]), 9, "camera rotation", source).reshape(3, 3)
    lens = Lens(k1, k2, p1, p2, higher=(k3,))
    size = (int(width), int(height))
    return Photo(image, K, size, from_center(rotation, center), source, lens=None if lens.flat else lens)


FORMAT = Format("pix4d", "..._calibrated_camera_parameters.txt (Pix4D)", recognises, read, rank=170)
