"""Put photographs into a scene's folder in a form that COLMAP reads, and leave out unreadable ones."""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.camera_search import Tell
from mgsr.data.camera_tags import read_tags
from mgsr.data.files import folded, images_below
from mgsr.data.find_scene import FEWEST_PHOTOS
from mgsr.data.images import DecodedImage, is_heif, read_picture
from mgsr.data.odd_files import RAW_CURE, RAW_SUFFIXES, VIDEO_ALONE, is_video_name, what_instead
from mgsr.data.shared_lenses import PhotoFile
from mgsr.errors import SceneError, in_short

_LEAST_READABLE = 0.5
_MOST_NAMED = 5

# The kinds of files that COLMAP's reader and MGSR's decode to the same pixels; all others are converted to PNG. A file
# that COLMAP's reader refuses can end the process.
_READ_BY_COLMAP = {
    "jpeg": (".jpg", ".jpeg", ".jfif"),
    "png": (".png",),
    "tiff": (".tif", ".tiff"),
    "bmp": (".bmp",),
    "targa": (".tga",),
    "pnm": (".ppm", ".pgm", ".pnm"),
}
_BYTES_AND_WORDS = ("uint8", "uint16")

# The brands of HEIC's family (ISO/IEC 23008-12, AV1 Image File Format); other files of that structure are videos.
_HEIF_BRANDS = (b"mif1", b"msf1", b"mif2", b"avif", b"avis", b"miaf", b"jpeg", b"jpgs")


@dataclass(frozen=True)
class Gathered:
    """The photographs in the scene's folder, and notes for the user on omitted files.

    originals: by the photographs' names in that folder, their names in the user's.
    """

    shots: tuple[PhotoFile, ...]
    notes: tuple[str, ...]
    originals: Mapping[str, str]


def find_photos(folder: Path, given: Path) -> list[Path]:
    """Find the photographs below a folder.

    given: the user's path, for messages. Raises SceneError, which describes the folder's files, if there are too few.
    """
    images = images_below(folder)
    if len(images) < FEWEST_PHOTOS:
        needed = f"at least {FEWEST_PHOTOS} are needed to find cameras; use 20 or more"
        text = f"{given}: it holds {len(images)} images, but {needed}"
        raise SceneError("; ".join([text, *_bystanders(folder, images)]))
    return images


def gather(photos: Path, images: Sequence[Path], folder: Path, tell: Tell = lambda done: None) -> Gathered:
    """Put the photographs below `photos` into `folder` as hard links, or as PNG if COLMAP can't read their format.

    If the disk has no hard links, files are copied. PNGs are 8-bit sRGB and keep their alpha. Each photograph is
    decoded once, so that damaged ones are found. tell: receives the share of the photographs that is done.

    Raises SceneError, with the first reason, if most photographs can't be read or too few are left.
    """
    shots: list[PhotoFile] = []
    originals: dict[str, str] = {}
    lost: dict[str, SceneError] = {}
    taken = {folded(str(image.relative_to(photos))) for image in images}
    for number, image in enumerate(images):
        tell(number / len(images))
        name = image.relative_to(photos)
        try:
            shots.append(_hand_over(image, name, folder, taken))
            originals[shots[-1].name] = name.as_posix()
        except SceneError as error:
            lost[name.as_posix()] = error
    if lost and (len(shots) < FEWEST_PHOTOS or len(shots) < _LEAST_READABLE * len(images)):
        first = next(iter(lost.values()))
        raise SceneError(f"{len(lost)} of {len(images)} photographs cannot be read; the first: {first}") from first
    notes = (*_notes_of_lost(lost, len(images)), *_bystanders(photos, images))
    return Gathered(tuple(shots), notes, originals)


def _notes_of_lost(lost: Mapping[str, SceneError], total: int) -> tuple[str, ...]:
    if not lost:
        return ()
    names = ", ".join(list(lost)[:_MOST_NAMED]) + (", ..." if len(lost) > _MOST_NAMED else "")
    first = in_short(next(iter(lost.values())))
    return (f"{len(lost)} of {total} photographs cannot be read and were skipped ({names}); the first: {first}",)


def _hand_over(image: Path, name: Path, folder: Path, taken: set[str]) -> PhotoFile:
    """Put one photograph into the folder under `name`, converted to PNG if necessary.

    taken: folded names in use; the name of a converted photograph is added. Raises SceneError for files that are not
    photographs.
    """
    _require_photo(image)
    picture = read_picture(image, "the search for cameras")
    tags = read_tags(image)
    converted = not _is_read_by_colmap(image)
    if converted:
        name = _free_name(name, taken)
    place = folder / name
    place.parent.mkdir(parents=True, exist_ok=True)
    if converted:
        place.write_bytes(_png(picture))
    else:
        _link(image, place)
    height, width = picture.colors.shape[:2]
    return PhotoFile(name.as_posix(), (width, height), tags)


def _require_photo(image: Path) -> None:
    if odd := what_instead(image):
        raise SceneError(f"{image.name} {odd}")
    if is_heif(image) and not _has_heif_brand(image):
        raise SceneError(f"{image.name} is a video, not a photograph; {VIDEO_ALONE}")


def _has_heif_brand(image: Path) -> bool:
    """Return whether the first box, of type ftyp, names a brand of HEIC's family (ISO/IEC 14496-12, 4.3)."""
    with image.open("rb") as file:
        head = file.read(256)
    box = head[8 : int.from_bytes(head[:4], "big")]
    brands = [box[:4], *(box[start : start + 4] for start in range(8, len(box), 4))]
    return any(brand in _HEIF_BRANDS or brand[:3] in (b"hei", b"hev") for brand in brands)


def _is_read_by_colmap(image: Path) -> bool:
    if is_heif(image):
        return False
    import OpenImageIO  # imported here, because training needs no OpenImageIO

    handle: Any = OpenImageIO.ImageInput.open(str(image))
    kind, depth = handle.format_name(), str(handle.spec().format)
    handle.close()
    return image.suffix.lower() in _READ_BY_COLMAP.get(kind, ()) and depth in _BYTES_AND_WORDS


def _free_name(name: Path, taken: set[str]) -> Path:
    """Return a free name for a photograph that becomes a PNG, and add it to `taken`.

    It is the photograph's own stem, with its extension and then a number added where that name is taken.
    """
    other = f"{name.stem}_{name.suffix[1:].lower()}"
    stems = itertools.chain([name.stem, other], (f"{other}_{number}" for number in itertools.count(2)))
    places = (name.with_name(f"{stem}.png") for stem in stems)
    free = next(place for place in places if folded(str(place)) not in taken)
    taken.add(folded(str(free)))
    return free


def _png(picture: DecodedImage) -> bytes:
    import cv2  # imported here, because few captures need it

    pixels = picture.colors[..., ::-1]
    if picture.alpha is not None:
        pixels = np.dstack([pixels, picture.alpha])
    return cv2.imencode(".png", pixels)[1].tobytes()


def _link(image: Path, place: Path) -> None:
    try:
        os.link(image.resolve(), place)
    except OSError:  # another disk, or one without links
        shutil.copyfile(image, place)


def _bystanders(folder: Path, images: Iterable[Path]) -> tuple[str, ...]:
    """Return notes on videos and raw photographs in the folder that have no photograph of the same name beside them.

    Cameras write a raw file beside each JPEG, and phones a short video beside each photograph; those are no loss.
    """
    known = {folded(str(image.with_suffix(""))) for image in images}
    files = [path for path in sorted(folder.rglob("*")) if not path.name.startswith(".") and path.is_file()]
    alone = [path for path in files if folded(str(path.with_suffix(""))) not in known]
    return (
        *_note_of(alone, is_video_name, "video", VIDEO_ALONE),
        *_note_of(alone, _is_raw, "raw photograph", RAW_CURE),
    )


def _note_of(files: Sequence[Path], is_kind: Callable[[Path], bool], what: str, cure: str) -> tuple[str, ...]:
    found = [path for path in files if is_kind(path)]
    if len(found) == 1:
        return (f"1 {what} ({found[0].name}) skipped; {cure}",)
    return (f"{len(found)} {what}s ({found[0].name}, ...) skipped; {cure}",) if found else ()


def _is_raw(path: Path) -> bool:
    return path.suffix.lower() in RAW_SUFFIXES
