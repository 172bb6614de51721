"""The layout of NSVF: intrinsics.txt, pose/*.txt and rgb/*. SRN, DeepVoxels, NeRF++ and Plenoxels have it too.

Poses map the camera to the world, with OpenCV's axes. Names begin with 0_ for training, 1_ for validation and 2_ for
testing. Source: the README of NSVF (facebookresearch/NSVF), "Dataset", and its issues 42 and 64. NeRF++ has intrinsics
for each photograph, and folders train/ and test/ with this layout. Plenoxels (sxyu/svox2) reads these scenes with pixel
centres at +0.5.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.images import image_size
from mgsr.data.number_files import calibrated_size, read_intrinsics, read_pose, texts_in
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import from_world_from_cam

_ONE_FILE = "intrinsics.txt"
_MANY_FILES = ("intrinsics", "intrinsic")
_POSES = ("pose", "poses")
_PHOTOGRAPHS = ("rgb", "images", "image")
_PREFIX = re.compile(r"([012])_")


class _NsvfSplit(Enum):
    """The use of a view, with the number at the start of its name."""

    TRAIN = 0
    VALIDATION = 1
    TEST = 2


@dataclass(frozen=True)
class _NsvfPhoto:
    """A photograph. place: the folder with pose/ and rgb/. pose: its pose's file. part: its use, None if unknown."""

    place: Path
    pose: Path
    part: _NsvfSplit | None

    @property
    def intrinsics(self) -> Path:
        """Return the photograph's own file of intrinsics, or the shared one if it has none."""
        own = (self.place / folder / self.pose.name for folder in _MANY_FILES)
        return next((path for path in own if path.is_file()), self.place / _ONE_FILE)

    @property
    def split(self) -> Split | None:
        return None if self.part is None else Split.TEST if self.part is _NsvfSplit.TEST else Split.TRAIN

    def photograph(self, root: Path) -> str:
        """Return the photograph's path relative to the root, without its extension."""
        folder = next((self.place / name for name in _PHOTOGRAPHS if (self.place / name).is_dir()), self.place)
        return (folder / self.pose.stem).relative_to(root).as_posix()

    def as_test(self) -> _NsvfPhoto:
        """Return a copy of the view that is for testing."""
        return replace(self, part=_NsvfSplit.TEST)


def recognises(root: Path) -> str | None:
    """Return the first file of intrinsics if the folder, or its train/, has intrinsics and poses."""
    places = [place for place in (root, root / "train") if _is_scene(place)]
    return _NsvfPhoto(places[0], _poses(places[0])[0], None).intrinsics.relative_to(root).as_posix() if places else None


def _is_scene(place: Path) -> bool:
    poses = _poses(place)
    return bool(poses) and _NsvfPhoto(place, poses[0], None).intrinsics.is_file()


def _poses(place: Path) -> list[Path]:
    return next((files for name in _POSES if (files := texts_in(place / name))), [])


def read(folder: SceneFolder) -> Capture:
    """Read all training and test views.

    Validation views serve as test views if there are no others; otherwise they are not used.
    """
    views, notes = _used(_views(folder.root))
    file = views[0].intrinsics.relative_to(folder.root).as_posix()
    found = folder.find_photos(file, [view.photograph(folder.root) for view in views], labels=True)
    capture = Capture.of(found, lambda i, image: _photo(folder.root, image, views[i]))
    return replace(capture, notes=(*capture.notes, *notes))


def _views(root: Path) -> list[_NsvfPhoto]:
    """Return every view with its split, given by the beginning of its name or by its folder."""
    if _is_scene(root):
        return [_NsvfPhoto(root, pose, _named_part(pose.stem)) for pose in _poses(root)]
    parts = {
        "train": _NsvfSplit.TRAIN,
        "validation": _NsvfSplit.VALIDATION,
        "val": _NsvfSplit.VALIDATION,
        "test": _NsvfSplit.TEST,
    }
    folders = [(root / name, part) for name, part in parts.items() if _is_scene(root / name)]
    return [_NsvfPhoto(folder, pose, part) for folder, part in folders for pose in _poses(folder)]


def _named_part(name: str) -> _NsvfSplit | None:
    match = _PREFIX.match(name)
    return _NsvfSplit(int(match[1])) if match else None


def _used(views: list[_NsvfPhoto]) -> tuple[list[_NsvfPhoto], tuple[str, ...]]:
    """Return the training and test views, and a note on the views left out.

    Validation views serve as test views if there are no others.
    """
    if not any(view.part is _NsvfSplit.TEST for view in views):
        return [view.as_test() if view.part is _NsvfSplit.VALIDATION else view for view in views], ()
    used = [view for view in views if view.part is not _NsvfSplit.VALIDATION]
    left = len(views) - len(used)
    return used, (f"{left} validation views are ignored because there are test views",) if left else ()


def _photo(root: Path, image: Path, view: _NsvfPhoto) -> Photo:
    source = view.pose.relative_to(root).as_posix()
    K, stated = read_intrinsics(view.intrinsics)
    return Photo(
        image=image,
        K=K,
        size=stated or calibrated_size(K, image_size(image, source)),
        cam_from_world=from_world_from_cam(read_pose(view.pose), source),
        source=source,
        split=view.split,
    )


FORMAT = Format("nsvf", f"{_ONE_FILE}, pose/ and rgb/ (NSVF, SRN, NeRF++, Plenoxels)", recognises, read, rank=150)
