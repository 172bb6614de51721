"""Bundler: bundle.out, the list of its photographs, and the photographs.

COLMAP, VisualSFM, RealityCapture and others export it too.

Cameras look along -z with y up. The origin of pixel coordinates is the middle of the image. The radial terms act on
x / z and y / z. Source: Bundler's user manual, "Output format and scene representation". A list has one photograph per
line; in some files a zero and a focal length follow its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import IMAGE_SUFFIXES
from mgsr.data.images import image_size
from mgsr.data.lens import Lens
from mgsr.data.number_lists import numbers, point_cloud
from mgsr.data.odd_files import require_content
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics, rigid
from mgsr.data.scene import PointCloud
from mgsr.errors import SceneError, in_short

# The original program writes bundles to a folder of their own, and the list beside that folder.
_FOLDERS = (".", "bundle")
_USUAL = ("bundle.out", "bundle.rd.out")
_VERSIONS = ("v0.1", "v0.2", "v0.3")
_PER_CAMERA = 15
_LARGEST_LIST = 1 << 26  # bytes
_LIST_LINE = re.compile(r"(.*?)(?:\s+\d+(?:\s+[-+.\deE]+)?)?\s*")


def recognises(root: Path) -> str | None:
    """Return the first bundle file of the folder, or of its bundle/; files with usual names come first."""
    found = [path for folder in _FOLDERS for path in sorted((root / folder).glob("[!.]*.out")) if _is_bundle(path)]
    best = min(found, key=lambda path: path.name not in _USUAL, default=None)
    return best.relative_to(root).as_posix() if best else None


def read(folder: SceneFolder) -> Capture:
    """Read every point, and every camera with the photograph on its line of the list."""
    file = recognises(folder.root)
    assert file is not None, "read() accepts recognised folders only"
    bundle = _bundle(folder.root / file)
    listed = _list(folder.root, folder.root / file, len(bundle.cameras))
    places = (".", listed.path.parent.relative_to(folder.root).as_posix(), PurePosixPath(file).parent.as_posix())
    found = folder.find_photos(listed.path.name, listed.names, places)
    capture = Capture.of(
        found, lambda i, path: _photo(path, bundle.cameras[i], f"{file}, camera {i} ({folder.shown(path)})")
    )
    return replace(capture, points=bundle.points, least_kept=0.25)


@dataclass(frozen=True)
class _Bundle:
    """The content of a bundle file. cameras: each camera's numbers, as words."""

    cameras: list[list[str]]
    points: PointCloud | None


@dataclass(frozen=True)
class _List:
    """A list of photographs: its file, and their names in the order of the cameras."""

    path: Path
    names: list[str]


def _is_bundle(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(100).removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    except OSError:
        return False
    return head.startswith(b"# bundle file") or (path.name in _USUAL and re.match(rb"\d+\s+\d+\s", head) is not None)


def _bundle(path: Path) -> _Bundle:
    require_content(path)
    try:
        with path.open(encoding="utf-8-sig") as file:
            words = _Words(_without_comments(file, path.name))
            cameras, points = words.whole(), words.whole()
            return _Bundle([words.take(_PER_CAMERA) for _ in range(cameras)], _points(words, points))
    except (OSError, ValueError, OverflowError) as error:
        raise SceneError(f"{path.name}: damaged bundle file: {in_short(error)}; export it again") from error


def _without_comments(lines: Iterable[str], name: str) -> Iterator[str]:
    for line in lines:
        if not line.startswith("#"):
            yield line
        elif (version := re.search(r"bundle file\s+(\S+)", line, re.IGNORECASE)) and version[1] not in _VERSIONS:
            raise SceneError(
                f"{name}: MGSR does not read version {version[1][:20]} of bundle files; export {_VERSIONS[-1]} or "
                "another format (docs/inputs.md)"
            )


class _Words:
    """A reader that takes words from lines of text."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines, self._words, self._at = lines, [""], 1

    def take(self, count: int) -> list[str]:
        """Return the next `count` words. Raises ValueError if the text ends too early."""
        taken: list[str] = []
        while len(taken) < count:
            if self._at == len(self._words):
                self._next_line()
            part = self._words[self._at : self._at + count - len(taken)]
            self._at += len(part)
            taken += part
        return taken

    def whole(self) -> int:
        """Return the next word as a whole number. Raises ValueError if it is negative."""
        value = int(self.take(1)[0])
        if value < 0:
            raise ValueError(f"expected a count, got {value}")
        return value

    def _next_line(self) -> None:
        line = next(self._lines, None)
        if line is None:
            raise ValueError("the file is truncated")
        self._words, self._at = line.split(), 0


def _points(words: _Words, count: int) -> PointCloud | None:
    """Return the points with their colours, and skip the lists of views that see them."""
    places, colors = [], []
    for _ in range(count):
        places.append(words.take(3))
        colors.append(words.take(3))
        words.take(4 * words.whole())
    return point_cloud(places, colors)


def _list(root: Path, bundle: Path, cameras: int) -> _List:
    """Find the list of the bundle's photographs.

    A list with a usual name comes first, else the only list with as many photographs as the bundle has cameras. Raises
    SceneError if no list fits, or more than one.
    """
    folders = list(dict.fromkeys((bundle.parent, root)))
    usual = (folder / name for folder in folders for name in _usual_lists(bundle))
    for path in usual:
        if path.is_file():
            names = _names(path)
            if len(names) != cameras:
                raise SceneError(
                    f"{path.name}: the list names {len(names)} photographs, but {bundle.name} has {cameras} cameras; "
                    "use the list that belongs to it"
                )
            return _List(path, names)
    others = [path for folder in folders for kind in ("*.txt", "*.lst") for path in sorted(folder.glob(kind))]
    fitting = [_List(path, names) for path in others if len(names := _names(path)) == cameras and _are_images(names)]
    if len(fitting) != 1:
        raise SceneError(
            f"{bundle.name}: expected one list of its {cameras} photographs, found {len(fitting)}; add "
            f"{_usual_lists(bundle)[0]} beside it, with one photograph's name per line, in the order of the cameras"
        )
    return fitting[0]


def _usual_lists(bundle: Path) -> list[str]:
    """Return the names that Bundler, VisualSFM, COLMAP, multicore bundle adjustment and others give to the list."""
    stem = bundle.name.removesuffix(".out")
    names = [stem.replace("bundle", "list") + ".txt"] if "bundle" in stem else []
    return [*names, f"{stem}-list.txt", f"{stem}.list.txt", f"{bundle.name}.list.txt", f"{stem}.lst", f"{stem}.out.lst"]


def _names(path: Path) -> list[str]:
    """Return the names in a list, or an empty list if the file is not text or too large."""
    try:
        if path.stat().st_size > _LARGEST_LIST:
            return []
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError):
        return []
    return [_name(line) for line in lines if line.strip() and not line.startswith("#")]


def _name(line: str) -> str:
    match = _LIST_LINE.fullmatch(line.strip())
    return match[1] if match else line


def _are_images(names: list[str]) -> bool:
    return bool(names) and all(PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES for name in names)


def _photo(image: Path, camera: list[str], source: str) -> Photo:
    values = numbers(camera, _PER_CAMERA, "the camera", source)
    f, k1, k2 = values[:3]
    if f == 0:
        raise SceneError(f"{source}: it has no pose (its focal length is 0)")
    size = image_size(image, source)
    lens = Lens(k1, k2)
    opencv = np.diag([1.0, -1, -1])
    return Photo(
        image=image,
        K=intrinsics(f, f, size[0] / 2, size[1] / 2),
        size=size,
        cam_from_world=rigid(opencv @ values[3:12].reshape(3, 3), opencv @ values[12:]),
        source=source,
        lens=None if lens.flat else lens,
    )


FORMAT = Format("bundler", "bundle.out and list.txt (Bundler, COLMAP, VisualSFM)", recognises, read, rank=130)
