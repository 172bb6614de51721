"""MGSR's own plain form: cameras.json, a list of views with K, cam_from_world and image (docs/inputs.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import find_image, inside, read_json
from mgsr.data.images import image_size
from mgsr.data.poses import matrix_from
from mgsr.data.registration import check_share
from mgsr.errors import SceneError

_FILE = "cameras.json"


def recognises(root: Path) -> str | None:
    """cameras.json, if it has "views" (other programs write files of that name too)."""
    path = root / _FILE
    if not path.is_file():
        return None
    try:
        content = read_json(path)
    except SceneError:
        return _FILE  # so that reading it tells what is wrong with it
    return _FILE if isinstance(content, dict) and "views" in content else None


def read(root: Path) -> Capture:
    """Every view of the file whose photograph is there. Raises SceneError where more than half are missing."""
    content = read_json(root / _FILE)
    views = content["views"]
    if not isinstance(views, list) or not all(isinstance(view, dict) for view in views):
        raise SceneError(f"{_FILE}: 'views': expected a list of objects with K, cam_from_world and image")
    splits = [_split(view, i) for i, view in enumerate(views)]
    # Views that say nothing train, as soon as one view says something.
    default = Split.TRAIN if any(splits) else None
    photos = [_read_view(root, view, i, splits[i] or default) for i, view in enumerate(views)]
    there = [photo for photo in photos if photo is not None]
    missing = [str(view["image"]) for view, photo in zip(views, photos, strict=True) if photo is None]
    cure = f"put the missing ones into {root.name} under the paths that {_FILE} has"
    return Capture(there, notes=check_share(len(there), len(photos), 0.5, f"of {_FILE} are there", cure, missing))


def _read_view(root: Path, view: dict[str, Any], index: int, split: Split | None) -> Photo | None:
    source = f"{_FILE}, view {index}"
    image = find_image(root, view.get("image"), source)
    if not image.is_file():
        return None
    source = f"{source} ({image.relative_to(root)})"
    return Photo(
        image=image,
        K=matrix_from(view.get("K"), 3, 3, "K", source),
        size=image_size(image, source),
        cam_from_world=matrix_from(view.get("cam_from_world"), 4, 4, "cam_from_world", source),
        source=source,
        mask=inside(root, view["mask"], source) if view.get("mask") is not None else None,
        split=split,
    )


def _split(view: dict[str, Any], index: int) -> Split | None:
    value = view.get("split")
    if value not in (None, *Split):
        raise SceneError(f"{_FILE}, view {index}: split: expected 'train' or 'test', got {value!r}")
    return None if value is None else Split(value)


FORMAT = Format("plain", f'{_FILE} with "views" (MGSR\'s own form, docs/inputs.md)', recognises, read, rank=10)
