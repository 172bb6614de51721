"""MGSR's own format: cameras.json with a list of views, each with K, cam_from_world and image (docs/inputs.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import read_json
from mgsr.data.images import image_size
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import matrix_from, pose_from
from mgsr.errors import SceneError

_FILE = "cameras.json"


def recognises(root: Path) -> str | None:
    """Return cameras.json if it has "views". Other programs write files of that name too."""
    path = root / _FILE
    if not path.is_file():
        return None
    try:
        content = read_json(path)
    except SceneError:
        return _FILE  # then `read` reports the error
    return _FILE if isinstance(content, dict) and "views" in content else None


def read(folder: SceneFolder) -> Capture:
    """Read every view of the file. Raises SceneError if `views` is not a list of objects."""
    views = read_json(folder.root / _FILE)["views"]
    if not isinstance(views, list) or not all(isinstance(view, dict) for view in views):
        raise SceneError(f"{_FILE}: views: expected a list of objects with K, cam_from_world and image; fix the file")
    splits = [_split(view, i) for i, view in enumerate(views)]
    # If any view names its split, the views without one are for training.
    default = Split.TRAIN if any(splits) else None
    found = folder.find_photos(_FILE, [view.get("image") for view in views])
    return Capture.of(found, lambda i, path: _photo(folder, path, views[i], i, splits[i] or default))


def _photo(folder: SceneFolder, image: Path, view: dict[str, Any], index: int, split: Split | None) -> Photo:
    source = f"{_FILE}, view {index} ({folder.shown(image)})"
    return Photo(
        image=image,
        K=matrix_from(view.get("K"), 3, 3, "K", source),
        size=image_size(image, source),
        cam_from_world=pose_from(view.get("cam_from_world"), "cam_from_world", source),
        source=source,
        mask=_mask(folder, view, source),
        split=split,
    )


def _mask(folder: SceneFolder, view: dict[str, Any], source: str) -> Path | None:
    if view.get("mask") is None:
        return None
    if (mask := folder.find_file(view["mask"], f"{source}, mask")) is None:
        raise SceneError(f"{source}: its mask {str(view['mask'])[:200]} is missing; add it, or name no mask")
    return mask


def _split(view: dict[str, Any], index: int) -> Split | None:
    value = view.get("split")
    if value not in (None, *Split):
        raise SceneError(f"{_FILE}, view {index}: split: expected 'train' or 'test', got {value!r}")
    return None if value is None else Split(value)


FORMAT = Format("plain", f'{_FILE} with "views" (MGSR\'s own form, docs/inputs.md)', recognises, read, rank=10)
