"""Cameras for photographs that have none, by COLMAP (pycolmap): a scene folder with images/ and sparse/0."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mgsr.data.archive import unpack
from mgsr.data.files import images_below, view_names
from mgsr.data.images import is_heif, read_image
from mgsr.data.registration import check_share
from mgsr.errors import ConfigError, SceneError

# Up to here each photograph is matched with each other one; beyond, that takes hours, and each is matched with those
# that follow it by name, as in a video.
EXHAUSTIVE_UP_TO = 300
_FOLLOWING = 30

# What COLMAP can't read, by name or by content, is handed to it as PNG.
_CONVERTED = (".heic", ".heif")
_LEAST_REGISTERED = 0.25

Say = Callable[[str], None]


def find_poses(photos: Path, scene: Path, seed: int, say: Say = print) -> tuple[str, ...]:
    """Make the folder `scene` from the photographs below `photos`, a folder or an archive: COLMAP's largest model in
    sparse/0 and the photographs in images/ (hard links where the disk allows it).

    The same seed gives the same choices of COLMAP's random samples; its threads may still differ in the last digits.
    say: told in a line what is being done. Returns notes on what was left out. Raises ConfigError without pycolmap or
    where `scene` holds something, and SceneError where most photographs can't be placed; then no `scene` is left.
    """
    colmap = _pycolmap()
    folder = unpack(photos) if photos.is_file() else photos
    images = images_below(folder)
    if len(images) < 3:
        raise SceneError(f"{photos}: {len(images)} images; at least 3 are needed to find cameras, 20 or more are good")
    view_names(images)  # two photographs of one name are refused before an hour of matching, not after
    if scene.exists() and any(scene.iterdir()):
        raise ConfigError(f"{scene}: is not empty; name a new folder for the scene")
    scene.mkdir(parents=True, exist_ok=True)
    try:
        names = _gather(folder, images, scene / "images")
        with tempfile.TemporaryDirectory(prefix="mgsr-poses-") as work:
            model = _largest(_run(colmap, scene / "images", names, Path(work), seed, say))
        count = model.num_reg_images() if model is not None else 0
        cure = "take more photographs, with more overlap and of a still scene with texture"
        notes = check_share(count, len(names), _LEAST_REGISTERED, "could be placed", cure)
        if model is None or count < 2:
            raise SceneError(f"{photos}: no photographs could be placed; {cure}")
        (scene / "sparse/0").mkdir(parents=True)
        model.write(str(scene / "sparse/0"))
    except BaseException:
        shutil.rmtree(scene, ignore_errors=True)
        raise
    error = model.compute_mean_reprojection_error()
    say(f"{count} photographs placed, {model.num_points3D()} points, off by {error:.2f} pixels in the mean")
    return notes


def _pycolmap() -> Any:
    try:
        import pycolmap
    except ImportError as error:
        raise ConfigError("finding cameras needs pycolmap; install it with `pip install 'mgsr[poses]'`") from error
    pycolmap.logging.minloglevel = 2  # its errors come as exceptions, and its chatter is not for our users
    pycolmap.logging.logtostderr = True  # else it leaves files in the folder for temporary ones
    if threading.current_thread() is threading.main_thread():
        # It took SIGTERM for itself, and would end without any cleanup.
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    return pycolmap


def _gather(photos: Path, images: Sequence[Path], folder: Path) -> list[str]:
    """The photographs under `folder`; their paths in it."""
    names = []
    for image in images:
        place = folder / image.relative_to(photos)
        place.parent.mkdir(parents=True, exist_ok=True)
        if image.suffix.lower() in _CONVERTED or is_heif(image):
            place = place.with_suffix(".png")
            _convert(image, place)
        else:
            _link(image, place)
        names.append(place.relative_to(folder).as_posix())
    return names


def _link(image: Path, place: Path) -> None:
    try:
        os.link(image.resolve(), place)
    except OSError:  # another disk, or one without links
        shutil.copyfile(image, place)


def _convert(image: Path, place: Path) -> None:
    import cv2  # late: few captures need it

    colors, _ = read_image(image, "the folder")
    cv2.imwrite(str(place), colors[..., ::-1])


def _run(colmap: Any, folder: Path, names: Sequence[str], work: Path, seed: int, say: Say) -> Sequence[Any]:
    """COLMAP's models of the photographs."""
    colmap.set_random_seed(seed)
    database = work / "database.db"
    say(f"finding features in {len(names)} photographs")
    colmap.extract_features(database, folder, image_names=list(names))
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    if len(names) <= EXHAUSTIVE_UP_TO:
        say(f"matching {len(names) * (len(names) - 1) // 2} pairs of photographs")
        colmap.match_exhaustive(database, verification_options=verification)
    else:
        say(f"matching each photograph with the {_FOLLOWING} that follow it by name")
        pairing = colmap.SequentialPairingOptions(overlap=_FOLLOWING)
        colmap.match_sequential(database, pairing_options=pairing, verification_options=verification)
    placed = _Counter(len(names), say)
    options = colmap.IncrementalPipelineOptions(random_seed=seed, min_model_size=min(10, len(names)))
    models = colmap.incremental_mapping(
        database, folder, work, options, initial_image_pair_callback=placed.first, next_image_callback=placed.next
    )
    return list(models.values())


class _Counter:
    """Says how many photographs COLMAP has placed, every now and then."""

    def __init__(self, total: int, say: Say) -> None:
        self._total, self._say = total, say
        self._placed = 0

    def first(self) -> None:
        self._placed = 2

    def next(self) -> None:
        self._placed += 1
        if self._placed % 10 == 0:
            self._say(f"placed {self._placed} of {self._total} photographs")


def _largest(models: Sequence[Any]) -> Any:
    return max(models, key=lambda model: model.num_reg_images(), default=None)
