"""Read a folder or archive of posed photographs as a Scene in its normalised frame."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path

from mgsr.config import DataConfig, Masks
from mgsr.data.archive import archive_stem, unpack
from mgsr.data.capture import Capture, Photo, Split
from mgsr.data.coverage import note_of_few_views
from mgsr.data.files import IMAGE_SUFFIXES, view_names
from mgsr.data.find_scene import find_scene, scene_around
from mgsr.data.loading import LoadedView, LoadProgress, load_views
from mgsr.data.mask_files import MaskIndex
from mgsr.data.mask_use import MaskUse, require_plausible_ball
from mgsr.data.normalise import OUTLINE_SIDE, normalisation
from mgsr.data.odd_files import VIDEO_CURE, is_video, what_instead
from mgsr.data.odd_masks import agreeing_masks
from mgsr.data.photo_files import SceneFolder
from mgsr.data.scene import PointCloud, Scene, Similarity, View
from mgsr.data.settle_masks import SettledViews, settle_masks
from mgsr.data.sharpness import without_blurred
from mgsr.data.silhouettes import silhouettes
from mgsr.data.usable import usable_photos
from mgsr.errors import ConfigError, SceneError

# The names of camera files that users pass instead of their folder.
_CAMERA_SUFFIXES = (".json", ".xml", ".csv", ".txt", ".bin", ".npz", ".npy", ".nvm", ".out", ".sfm", ".log", ".ply")


def load_scene(
    path: str | os.PathLike[str],
    config: DataConfig | None = None,
    unpack_to: Path | None = None,
    progress: LoadProgress | None = None,
) -> Scene:
    """Load the scene at `path`, a folder or an archive of any supported format, and decode its images.

    config: the settings of the reading; None means the defaults. unpack_to: where an archive's files go; by default a
    folder that is removed when the process ends. progress: called every few seconds with the numbers of decoded and of
    all photographs. A name is unique within train and within test. `test` is empty where the files name no split and
    there are fewer than `config.test_every` views.

    Raises SceneError, before anything is trained, naming the file and the cure.
    """
    config = DataConfig() if config is None else config
    _check_config(config)
    path = Path(path)
    found = find_scene(_as_folder(path, unpack_to), path, config.confined)
    capture = found.kind.read(found.folder)
    if not capture.photos and path.is_dir() and not config.confined and (around := scene_around(path)):
        found, capture = around, around.kind.read(around.folder)
    present, lost = usable_photos(capture, found.folder)
    photos, unused = _with_masks(present, found.folder, config.masks)
    train, test = split(photos, config.test_every)
    if len(train) < 2:
        raise SceneError(f"{path.name}: expected at least 2 training views, got {len(train)}; use 20 or more")
    views = _load(train, test, config, progress)
    outlines = silhouettes(views.train, OUTLINE_SIDE)
    agreeing, odd = agreeing_masks(views.train, outlines)
    train_views = list(compress(views.train, agreeing))
    # Ignored regions still lie within the view.
    in_view = (
        [replace(view, valid_mask=None) for view in train_views] if views.ignoring and not outlines else train_views
    )
    frame = normalisation(in_view, capture.points, list(compress(outlines, agreeing)))
    if outlines and views.use is MaskUse.OBJECT and config.masks is Masks.AUTO:
        masks = [view.alpha for view in train_views if view.alpha is not None]
        require_plausible_ball(frame.scale, masks, [view.camera for view in train_views])
    few = note_of_few_views(train_views, frame.offset, masked=bool(outlines))
    return Scene(
        name=archive_stem(path) if path.is_file() else found.name,
        root=found.folder.root,
        format=found.kind.name,
        train=[_to_scene(view, frame) for view in train_views],
        test=[_to_scene(view, frame) for view in views.test],
        points=_points_to_scene(capture, frame),
        user_from_scene=frame,
        notes=(*found.notes, *capture.notes, *lost, *unused, *views.notes, *odd, *((few,) if few else ())),
        warning=few,
        ignoring=views.ignoring,
        source=path,
        read_with=config,
    )


def split(photos: Sequence[Photo], test_every: int) -> tuple[list[Photo], list[Photo]]:
    """Split the photographs, ordered by name, into training and test ones.

    The files' own split comes first. Without one, every n-th photograph is a test, from the first on; fewer than n
    photographs are all needed for training.
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
        raise SceneError(f"{path}: this folder or file does not exist")
    if odd := what_instead(path):
        raise SceneError(f"{path} {odd}")
    if is_video(path):
        raise SceneError(f"{path} is a video; {VIDEO_CURE}")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise SceneError(f"{path}: this is a single photograph; use the folder of all photographs and their cameras")
    if path.suffix.lower() in _CAMERA_SUFFIXES:
        raise SceneError(f"{path}: this is one file of a scene; use the folder that holds it and the photographs")
    return unpack(path, unpack_to)


def _with_masks(photos: list[Photo], folder: SceneFolder, masks: Masks) -> tuple[list[Photo], tuple[str, ...]]:
    """Return the photographs with the masks that lie beside them under their names, where the files name none.

    Also returns a note where masks can't be assigned: none has a photograph's name, or one fits several photographs.
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


def _load(train: list[Photo], test: list[Photo], config: DataConfig, progress: LoadProgress | None) -> SettledViews:
    """Load the training and test photographs and settle their masks.

    Names are unique within train and within test only: NeRF-synthetic scenes call views of both r_0.
    """
    names = [view_names([photo.image for photo in part]) for part in (train, test)]
    loaded = load_views(train + test, names[0] + names[1], config, progress)
    lost = [item for item in loaded if isinstance(item, SceneError)]
    trained, tested = (
        [item for item in part if isinstance(item, LoadedView)] for part in (loaded[: len(train)], loaded[len(train) :])
    )
    if len(trained) < 2:
        raise lost[0]
    sharp, blurred = without_blurred(trained, tested, config.blurred)
    settled = settle_masks(*sharp, config.masks)
    unread = (f"{len(lost)} of {len(loaded)} photographs skipped: {lost[0]}",) if lost else ()
    return replace(settled, notes=(*unread, *settled.notes, *blurred))


def _to_scene(view: View, frame: Similarity) -> View:
    return replace(view, camera=frame.camera_to_scene(view.camera))


def _points_to_scene(capture: Capture, frame: Similarity) -> PointCloud | None:
    if capture.points is None or not len(capture.points.positions):
        return None
    return PointCloud(frame.to_scene(capture.points.positions), capture.points.colors)
