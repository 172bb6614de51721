"""Read a folder or an archive of photographs, or a video, as a Scene in its normalised frame."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path

from mgsr.config import DataConfig, Masks, Object
from mgsr.config.expert import DataOptions
from mgsr.data.archive import archive_stem, temporary_folder, unpack
from mgsr.data.camera_search import CameraSearch
from mgsr.data.capture import Capture, Photo, Split
from mgsr.data.coverage import note_of_few_views
from mgsr.data.files import IMAGE_SUFFIXES, view_names
from mgsr.data.find_cameras import with_cameras
from mgsr.data.find_scene import FEWEST_PHOTOS, FoundScene, find_scene, scene_around
from mgsr.data.loading import LoadedView, LoadProgress, load_views
from mgsr.data.mask_files import MaskIndex
from mgsr.data.mask_use import MaskUse, require_plausible_ball
from mgsr.data.normalise import normalisation
from mgsr.data.object_place import read_object_place
from mgsr.data.odd_files import VIDEO_CURE, is_read_video_name, is_video_name, what_instead
from mgsr.data.odd_masks import agreeing_masks
from mgsr.data.photo_files import SceneFolder
from mgsr.data.scene import PointCloud, Scene, Similarity, View
from mgsr.data.settle_masks import SettledViews, settle_masks
from mgsr.data.sharpness import without_blurred
from mgsr.data.silhouettes import view_silhouettes
from mgsr.data.usable import usable_photos
from mgsr.errors import ConfigError, SceneError

# Suffixes of camera files, which users may pass instead of their folder.
_CAMERA_SUFFIXES = (".json", ".xml", ".csv", ".txt", ".bin", ".npz", ".npy", ".nvm", ".out", ".sfm", ".log", ".ply")


def load_scene(
    path: str | os.PathLike[str],
    config: DataConfig | None = None,
    unpack_to: Path | None = None,
    progress: LoadProgress | None = None,
    search: CameraSearch | None = None,
    options: DataOptions = DataOptions(),
) -> Scene:
    """Load the scene at `path`, a folder, an archive or a video, and decode its images.

    If the photographs have no cameras, structure from motion finds them, which takes minutes.

    config: the settings; None means the defaults.
    unpack_to: the folder for an archive's files, by default a temporary one.
    progress: called every few seconds with the numbers of decoded and of all photographs.
    search: the terms of a search for cameras.
    options: the expert options.

    View names are unique within train and within test. `test` is empty if the files name no split and there are fewer
    than `config.test_every` views.

    Raises SceneError, which names the file and the remedy, and ConfigError for settings out of range.
    """
    config = DataConfig() if config is None else config
    found = find_capture(path, config, unpack_to)
    found = with_cameras(found, config, search or CameraSearch(), options)
    return load_capture(found, config, progress, options)


def find_capture(
    path: str | os.PathLike[str], config: DataConfig | None = None, unpack_to: Path | None = None
) -> FoundScene:
    """Find the scene at `path` without reading its cameras and photographs.

    The arguments are those of `load_scene`. Raises SceneError if there is no scene, and ConfigError for settings out of
    range.
    """
    config = DataConfig() if config is None else config
    _check_config(config)
    path = Path(path)
    return find_scene(_as_folder(path, unpack_to), path, config.confined)


def load_capture(
    found: FoundScene,
    config: DataConfig,
    progress: LoadProgress | None = None,
    options: DataOptions = DataOptions(),
) -> Scene:
    """Read a scene that `find_capture` found, and decode its images; see `load_scene`.

    Raises SceneError if it can't be read or has too few views.
    """
    path = found.given
    capture = _read(found)
    if not capture.photos and path.is_dir() and not config.confined and (around := scene_around(path)):
        found, capture = around, _read(around)
    present, lost = usable_photos(capture, found.folder)
    photos, unused = _with_masks(present, found.folder, config.masks)
    train, test = split(photos, config.test_every)
    if len(train) < 2:
        raise SceneError(f"{path.name}: expected at least 2 training views, got {len(train)}; use 20 or more")
    views = _load(train, test, config, progress, options)
    silhouettes = view_silhouettes(views.train, options.normalisation.contour_side)
    agreeing, odd = agreeing_masks(views.train, silhouettes, options.odd_masks)
    train_views = list(compress(views.train, agreeing))
    # Normalisation counts the whole view, ignored regions included.
    in_view = (
        [replace(view, valid_mask=None) for view in train_views] if views.ignoring and not silhouettes else train_views
    )
    frame = normalisation(in_view, capture.points, list(compress(silhouettes, agreeing)), options.normalisation)
    if silhouettes and views.use is MaskUse.OBJECT and config.masks is Masks.AUTO:
        masks = [view.alpha for view in train_views if view.alpha is not None]
        require_plausible_ball(frame.scale, masks, [view.camera for view in train_views], options.mask_use)
    place, no_place = read_object_place(found.folder) if config.object is Object.AUTO else (None, ())
    ground = None
    if place is not None and place.ground is not None and silhouettes:
        ground = frame.inverse.plane_to_user(place.ground)
    few = note_of_few_views(train_views, frame.offset, bool(silhouettes), options.view_count)
    assert found.kind is not None
    return Scene(
        name=_stem(path) if path.is_file() else found.name,
        root=found.folder.root,
        format=found.kind.name,
        train=[_to_scene(view, frame) for view in train_views],
        test=[_to_scene(view, frame) for view in views.test],
        points=_points_to_scene(capture, frame),
        user_from_scene=frame,
        notes=(*found.notes, *capture.notes, *lost, *unused, *views.notes, *odd, *no_place, *((few,) if few else ())),
        warning=few,
        ignoring=views.ignoring,
        source=path,
        read_with=config,
        options=options,
        ground=ground,
        masks_found=place is not None and bool(silhouettes),
        object_place=place,
    )


def _read(found: FoundScene) -> Capture:
    """Read the cameras of a scene, which must have a format."""
    assert found.kind is not None, "the cameras must have been searched for"
    return found.kind.read(found.folder)


def split(photos: Sequence[Photo], test_every: int) -> tuple[list[Photo], list[Photo]]:
    """Split photographs into training and test photographs, each ordered by name.

    The files' own split is used if they name one. Otherwise every `test_every`-th photograph is for testing, from the
    first on; if there are fewer than `test_every`, all are for training.
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
    for name, least in (("test_every", 1), ("max_side", 1), ("video_frames", FEWEST_PHOTOS)):
        if getattr(config, name) < least:
            raise ConfigError(f"data.{name}: expected at least {least}, got {getattr(config, name)}")


def _as_folder(path: Path, unpack_to: Path | None) -> Path:
    if path.is_dir():
        return path
    if not path.exists():
        raise SceneError(f"{path}: this folder or file does not exist")
    if odd := what_instead(path):
        raise SceneError(f"{path} {odd}")
    if is_read_video_name(path):
        return _folder_of_video(path)
    if is_video_name(path):
        raise SceneError(f"{path} is a video of a kind that is not read; {VIDEO_CURE}")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise SceneError(f"{path}: this is a single photograph; use the folder of all photographs")
    if path.suffix.lower() in _CAMERA_SUFFIXES:
        raise SceneError(f"{path}: this is one file of a scene; use the folder that holds it and the photographs")
    return unpack(path, unpack_to)


def _stem(path: Path) -> str:
    """Return the name of an archive or a video without suffix."""
    return path.stem if is_video_name(path) else archive_stem(path)


def _folder_of_video(path: Path) -> Path:
    """Create a folder that holds only a link to a video, and that is removed when the process ends."""
    folder = temporary_folder("mgsr-video-") / _stem(path)
    folder.mkdir()
    (folder / path.name).symlink_to(path.resolve())
    return folder


def _with_masks(photos: list[Photo], folder: SceneFolder, masks: Masks) -> tuple[list[Photo], tuple[str, ...]]:
    """Give each photograph without a mask the mask file of the same name.

    Returns the photographs, and a note if masks can't be assigned because none has a photograph's name, or one fits
    several photographs.
    """
    if masks is Masks.OFF:
        return photos, ()
    index = MaskIndex(folder)
    photos = [
        replace(photo, mask=photo.mask or index.find(photo.image), ignored=index.find_ignored(photo.image))
        for photo in photos
    ]
    used = Counter(photo.mask for photo in photos if photo.mask is not None)
    doubled = [mask for mask, count in used.items() if count > 1]
    if doubled:
        photos = [replace(photo, mask=None) if photo.mask in doubled else photo for photo in photos]
        name = folder.shown(doubled[0])
        return photos, (
            f"{name} may be the mask of several photographs, so it is ignored; sort the masks into the photographs' "
            "folders",
        )
    if not index.masks or any(photo.mask for photo in photos):
        return photos, ()
    mask, name = folder.shown(index.masks[0]), photos[0].image.stem
    return photos, (
        f"{mask} and the files beside it belong to no photograph; rename it to {name}.png to use it as a mask",
    )


def _load(
    train: list[Photo], test: list[Photo], config: DataConfig, progress: LoadProgress | None, options: DataOptions
) -> SettledViews:
    """Load the training and test photographs, and settle their masks.

    Names are unique only within train and within test, since NeRF-synthetic scenes have a view r_0 in both.
    """
    names = [view_names([photo.image for photo in part]) for part in (train, test)]
    loaded = load_views(train + test, names[0] + names[1], config, progress, options.undistortion)
    lost = [item for item in loaded if isinstance(item, SceneError)]
    trained, tested = (
        [item for item in part if isinstance(item, LoadedView)] for part in (loaded[: len(train)], loaded[len(train) :])
    )
    if len(trained) < 2:
        raise lost[0]
    sharp, blurred = without_blurred(trained, tested, config.flawed, options.sharpness)
    settled = settle_masks(*sharp, config.masks, options.mask_use)
    unread = (f"{len(lost)} of {len(loaded)} photographs skipped: {lost[0]}",) if lost else ()
    return replace(settled, notes=(*unread, *settled.notes, *blurred))


def _to_scene(view: View, frame: Similarity) -> View:
    return replace(view, camera=frame.camera_to_scene(view.camera))


def _points_to_scene(capture: Capture, frame: Similarity) -> PointCloud | None:
    if capture.points is None or not len(capture.points.positions):
        return None
    return PointCloud(frame.to_scene(capture.points.positions), capture.points.colors)
