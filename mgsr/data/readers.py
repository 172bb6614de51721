"""A folder or archive of posed photographs as a Scene in its normalised frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mgsr.config import DataConfig
from mgsr.data.archive import ARCHIVE_SUFFIXES, archive_stem, unpack
from mgsr.data.capture import Capture, Format, Photo, Split
from mgsr.data.files import images_below, view_names
from mgsr.data.formats import all_formats
from mgsr.data.loading import LoadProgress, load_views, settle_masks
from mgsr.data.normalise import normalisation
from mgsr.data.poses import check_intrinsics, check_pose
from mgsr.data.scene import PointCloud, Scene, Similarity, View
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
    root, kind = _find(_as_folder(Path(path), unpack_to))
    capture = kind.read(root)
    photos = [_checked(photo) for photo in _present(capture.photos, root)]
    train, test = split(photos, config.test_every)
    if len(train) < 2:
        raise SceneError(f"{Path(path).name}: {len(train)} training views; at least 2 are needed, 20 or more are good")
    train_views, test_views = _load(train, test, config, progress)
    frame = normalisation(train_views, capture.points)
    return Scene(
        name=archive_stem(Path(path)) if Path(path).is_file() else root.name,
        root=root,
        format=kind.name,
        train=[_to_scene(view, frame) for view in train_views],
        test=[_to_scene(view, frame) for view in test_views],
        points=_points_to_scene(capture, frame),
        user_from_scene=frame,
        notes=capture.notes,
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


def _find(folder: Path) -> tuple[Path, Format]:
    """The scene's own folder and its format: the folder itself, or the only folder in it, as archives often have."""
    formats = all_formats()
    root = folder
    while True:
        for kind in formats:
            if kind.recognises(root):
                return root, kind
        inner = [entry for entry in root.iterdir() if not entry.name.startswith((".", "__"))]
        if len(inner) != 1 or not inner[0].is_dir():
            break
        root = inner[0]
    raise _unknown(folder, root, formats)


def _unknown(folder: Path, root: Path, formats: Sequence[Format]) -> SceneError:
    """What is wrong with a folder that no format recognises."""
    looked = "; ".join(kind.looks_for for kind in formats)
    archives = [entry.name for entry in sorted(root.iterdir()) if entry.name.lower().endswith(ARCHIVE_SUFFIXES)]
    images = images_below(root)
    if archives:
        return SceneError(f"{folder}: no known scene in it, but another archive, {archives[0]}: unpack that first")
    if images:
        return SceneError(
            f"{folder}: {len(images)} images, but no cameras; find the cameras with `mgsr poses {folder} -o SCENE`, "
            f"or put them there. Looked for: {looked}. See docs/inputs.md"
        )
    state = "no known scene in it" if any(folder.iterdir()) else "the folder is empty"
    return SceneError(f"{folder}: {state}. Looked for: {looked}. See docs/inputs.md")


def _present(photos: Sequence[Photo], root: Path) -> Sequence[Photo]:
    """The photographs, none of which may be missing; one message for all, since a wrong folder loses them all."""
    if not photos:
        raise SceneError(f"{root}: the scene has no views")
    for what in ("image", "mask"):
        paths = {photo.source: path for photo in photos if (path := getattr(photo, what)) is not None}
        gone = [(source, path) for source, path in paths.items() if not path.is_file()]
        if gone:
            source, path = gone[0]
            more = f" and {len(gone) - 1} more" if len(gone) > 1 else ""
            raise SceneError(
                f"{what} {path.relative_to(root)}{more} missing in {root} (asked for by {source}); "
                "put it there or remove the view"
            )
    return photos


def _checked(photo: Photo) -> Photo:
    return replace(
        photo,
        K=check_intrinsics(photo.K, photo.size, photo.source),
        cam_from_world=check_pose(photo.cam_from_world, photo.source),
    )


def _load(
    train: list[Photo], test: list[Photo], config: DataConfig, progress: LoadProgress | None
) -> tuple[list[View], list[View]]:
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
