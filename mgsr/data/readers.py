"""A folder or archive of posed photographs as a Scene in its normalised frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path

from mgsr.config import DataConfig, Masks
from mgsr.data.archive import ARCHIVE_SUFFIXES, archive_stem, unpack
from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import images_below, view_names
from mgsr.data.formats import all_formats
from mgsr.data.loading import LoadProgress, SettledViews, load_views, settle_masks
from mgsr.data.mask_files import MaskIndex
from mgsr.data.normalise import OUTLINE_SIDE, normalisation
from mgsr.data.odd_masks import agreeing_masks
from mgsr.data.poses import check_intrinsics, check_pose
from mgsr.data.registration import check_share
from mgsr.data.scene import PointCloud, Scene, Similarity, View
from mgsr.data.silhouettes import silhouettes
from mgsr.errors import ConfigError, SceneError


def load_scene(
    path: Path, config: DataConfig, unpack_to: Path | None = None, progress: LoadProgress | None = None
) -> Scene:
    """The scene at `path`, a folder or an archive (.zip, .tar, .tar.gz, .tar.zst), whatever its format, with every
    image decoded.

    unpack_to: where an archive's files go; by default a folder that is removed when the process ends. progress: told
    every few seconds how many photographs are decoded, of how many.
    A name is unique within train and within test. `test` is empty where the files name no split and there are fewer
    than `config.test_every` views.

    Raises SceneError, before anything is trained, naming the file and the cure.
    """
    _check_config(config)
    root, kind, passed_over = _find(_as_folder(Path(path), unpack_to), Path(path))
    capture = kind.read(root)
    present, missing = _present(capture.photos, root)
    photos, unused = _with_masks([_checked(photo) for photo in present], root, config.masks)
    train, test = split(photos, config.test_every)
    if len(train) < 2:
        raise SceneError(f"{Path(path).name}: {len(train)} training views; at least 2 are needed, 20 or more are good")
    views = _load(train, test, config, progress)
    outlines = silhouettes(views.train, OUTLINE_SIDE)
    agreeing, odd = agreeing_masks(views.train, outlines)
    train_views = list(compress(views.train, agreeing))
    frame = normalisation(train_views, capture.points, list(compress(outlines, agreeing)))
    return Scene(
        name=archive_stem(Path(path)) if Path(path).is_file() else root.name,
        root=root,
        format=kind.name,
        train=[_to_scene(view, frame) for view in train_views],
        test=[_to_scene(view, frame) for view in views.test],
        points=_points_to_scene(capture, frame),
        user_from_scene=frame,
        notes=(*passed_over, *capture.notes, *missing, *unused, *views.notes, *odd),
    )


def split(photos: Sequence[Photo], test_every: int) -> tuple[list[Photo], list[Photo]]:
    """Training and test photographs, by name: as the files say, or else every n-th is a test, from the first on.

    Fewer than n photographs are all needed for training.
    """
    ordered = sorted(photos, key=lambda photo: photo.image)
    if any(photo.split for photo in ordered):
        return (
            [photo for photo in ordered if photo.split is not Split.TEST],
            [photo for photo in ordered if photo.split is Split.TEST],
        )
    if len(ordered) < test_every:
        return ordered, []
    return [photo for i, photo in enumerate(ordered) if i % test_every], ordered[::test_every]


def _check_config(config: DataConfig) -> None:
    for name in ("test_every", "max_side"):
        if getattr(config, name) < 1:
            raise ConfigError(f"data.{name}: expected at least 1, got {getattr(config, name)}")


def _as_folder(path: Path, unpack_to: Path | None) -> Path:
    if path.is_dir():
        return path
    if not path.exists():
        raise SceneError(f"{path}: no such folder or file")
    return unpack(path, unpack_to)


def _find(folder: Path, given: Path) -> tuple[Path, Format, tuple[str, ...]]:
    """The scene's own folder, its format, and a note where it could be read as another too: the folder itself, or the
    only one in it that holds a scene, as archives often have. given: what messages call the folder."""
    formats = all_formats()
    root = folder
    while not (found := _recognised(root, formats)):
        inner = [path for path in sorted(root.iterdir()) if path.is_dir() and not path.name.startswith((".", "__"))]
        scenes = [path for path in inner if _recognised(path, formats)]
        if len(scenes) > 1:
            names = ", ".join(path.name for path in scenes[:3])
            raise SceneError(f"{given}: {len(scenes)} scenes in it ({names}); give one of them")
        if not scenes and len(inner) != 1:
            raise _unknown(folder, root, given, formats)
        root = (scenes or inner)[0]
    (kind, file), *others = found
    left = " and ".join(f"{name} ({other.name})" for other, name in others)
    return root, kind, (f"read from {file} ({kind.name}); {left} in the same folder is not used",) if others else ()


def _recognised(root: Path, formats: Sequence[Format]) -> list[tuple[Format, str]]:
    """The formats that the folder may be read as, and the files that tell so."""
    return [(kind, file) for kind in formats if (file := kind.recognises(root))]


def _unknown(folder: Path, root: Path, given: Path, formats: Sequence[Format]) -> SceneError:
    """What is wrong with a folder that no format recognises. root: the only folder in it, or in that, and so on."""
    looked = "; ".join(kind.looks_for for kind in formats)
    archives = [entry.name for entry in sorted(root.iterdir()) if entry.name.lower().endswith(ARCHIVE_SUFFIXES)]
    images = images_below(folder)
    if archives:
        return SceneError(f"{given}: no known scene in it, but another archive, {archives[0]}: unpack that first")
    if images:
        return SceneError(
            f"{given}: {len(images)} images, but no cameras; find the cameras with `mgsr poses {given} -o SCENE`, "
            f"or put them there. Looked for: {looked}. See docs/inputs.md"
        )
    state = "no known scene in it" if any(folder.iterdir()) else "the folder is empty"
    return SceneError(f"{given}: {state}. Looked for: {looked}. See docs/inputs.md")


def _present(photos: Sequence[Photo], root: Path) -> tuple[list[Photo], tuple[str, ...]]:
    """The photographs whose files are there, and a note on the others. Raises SceneError where most are missing, and
    where a mask is that a file names."""
    if not photos:
        raise SceneError(f"{root.name}: the scene has no views")
    there = [photo.image.is_file() for photo in photos]
    kept = list(compress(photos, there))
    gone = [photo for photo, is_there in zip(photos, there, strict=True) if not is_there]
    missing = [f"{photo.image.relative_to(root)} of {photo.source}" for photo in gone]
    masks = [(photo.mask, photo.source) for photo in kept if photo.mask is not None and not photo.mask.is_file()]
    if masks:
        (mask, source), *others = masks
        more = f" and {len(others)} more" if others else ""
        raise SceneError(
            f"mask {mask.relative_to(root)}{more} missing in {root.name} (asked for by {source}); put it there or "
            "name none"
        )
    cure = f"put the photographs into {root.name}, where the cameras say that they are"
    return kept, check_share(len(kept), len(photos), 0.5, "are there", cure, missing)


def _with_masks(photos: list[Photo], root: Path, masks: Masks) -> tuple[list[Photo], tuple[str, ...]]:
    """The photographs with the masks that lie beside them under their names, where the files name none; and a note if
    there are masks of which none has a photograph's name."""
    if masks is Masks.OFF:
        return photos, ()
    index = MaskIndex(root)
    photos = [replace(photo, mask=photo.mask or index.find(photo.image)) for photo in photos]
    if not index.masks or any(photo.mask for photo in photos):
        return photos, ()
    mask, name = index.masks[0].relative_to(root), photos[0].image.stem
    return photos, (f"{mask} is no photograph's mask, nor is any beside it: name it as {name}.png to have it used",)


def _checked(photo: Photo) -> Photo:
    return replace(
        photo,
        K=check_intrinsics(photo.K, photo.size, photo.source),
        cam_from_world=check_pose(photo.cam_from_world, photo.source),
    )


def _load(train: list[Photo], test: list[Photo], config: DataConfig, progress: LoadProgress | None) -> SettledViews:
    """Train and test have their names to themselves: NeRF-synthetic scenes call views of both r_0."""
    names = [view_names([photo.image for photo in part]) for part in (train, test)]
    loaded = load_views(train + test, names[0] + names[1], config, progress)
    return settle_masks(loaded[: len(train)], loaded[len(train) :], config.masks)


def _to_scene(view: View, frame: Similarity) -> View:
    return replace(view, camera=frame.camera_to_scene(view.camera))


def _points_to_scene(capture: Capture, frame: Similarity) -> PointCloud | None:
    if capture.points is None or not len(capture.points.positions):
        return None
    return PointCloud(frame.to_scene(capture.points.positions), capture.points.colors)
