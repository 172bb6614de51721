"""Estimate cameras for photographs that have none, with COLMAP (pycolmap).

The result is a scene folder with images/ and sparse/0.
"""

from __future__ import annotations

import importlib
import importlib.util
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mgsr.data.archive import unpack
from mgsr.data.gather_photos import find_photos, gather
from mgsr.data.odd_files import VIDEO_CURE, is_video
from mgsr.data.registration import check_share
from mgsr.data.shared_lenses import Lens, describe_lenses, share_lenses
from mgsr.data.zoom_check import zoom_note
from mgsr.errors import ConfigError, SceneError, in_short

# Up to this number, all pairs of photographs are matched. Beyond it, that takes hours, and each photograph is matched
# with its successors by name, as in a video.
EXHAUSTIVE_UP_TO = 300
_FOLLOWING = 30

_LEAST_REGISTERED = 0.25

# COLMAP's own: one parameter of distortion, and 1.2 times the longer side where nothing is known of the focal length.
_LENS_MODEL = "SIMPLE_RADIAL"
_FOCAL_FACTOR = 1.2

Say = Callable[[str], None]


def find_poses(
    photos: Path, scene: Path, seed: int, say: Say = print, camera_per_image: bool = False
) -> tuple[str, ...]:
    """Estimate the cameras of the photographs below `photos`, a folder or an archive, and make the folder `scene`.

    The scene holds COLMAP's largest model in sparse/0 and the photographs in images/. They are hard links where the
    disk allows it, and PNG where COLMAP can't read the originals. The same seed gives the same choices of COLMAP's
    random samples; its threads may still differ in the last digits.

    say: receives a line on each stage. camera_per_image: give each photograph its own lens; otherwise the photographs
    of one camera share a lens. Returns notes on the photographs that could not be placed. Raises ConfigError without
    pycolmap or where `scene` holds something, and SceneError where most photographs can't be read or placed; then no
    `scene` is left.
    """
    _require_pycolmap()
    if is_video(photos) and photos.is_file():
        raise SceneError(f"{photos} is a video; {VIDEO_CURE}")
    folder = unpack(photos) if photos.is_file() else photos
    images = find_photos(folder, photos)
    if scene.exists() and any(scene.iterdir()):
        raise ConfigError(f"{scene}: the folder is not empty; choose a new folder for the scene")
    scene.mkdir(parents=True, exist_ok=True)
    try:
        gathered = gather(folder, images, scene / "images")
        for note in gathered.notes:  # before an hour of matching, not after
            say(note)
        lenses = [Lens((shot,)) for shot in gathered.shots] if camera_per_image else share_lenses(gathered.shots)
        say("a separate camera for each photograph" if camera_per_image else describe_lenses(lenses))
        model, notes = _placed(_pycolmap(), scene / "images", lenses, seed, say)
        (scene / "sparse/0").mkdir(parents=True)
        model.write(str(scene / "sparse/0"))
    except BaseException:
        shutil.rmtree(scene, ignore_errors=True)
        raise
    return notes


def _require_pycolmap() -> None:
    if importlib.util.find_spec("pycolmap") is None:
        raise ConfigError("finding cameras requires pycolmap; install it with `pip install 'mgsr[poses]'`")


def _pycolmap() -> Any:
    """Import pycolmap, with its logging and signal handlers set as MGSR needs them.

    pycolmap bundles its own OpenImageIO, and the copy that is loaded second uses parts of the first. The process
    crashes where our copy is the second and refuses a file, and where pycolmap's copy gets a file that it refuses.
    Raises ConfigError where pycolmap can't be loaded.
    """
    importlib.import_module("OpenImageIO")
    try:
        import pycolmap
    except ImportError as error:
        raise ConfigError(
            f"pycolmap cannot be loaded: {in_short(error)}; reinstall it with `pip install 'mgsr[poses]'`"
        ) from error
    pycolmap.logging.minloglevel = 2  # its errors arrive as exceptions, and its messages are not for our users
    pycolmap.logging.logtostderr = True  # else it leaves files in the folder for temporary ones
    if threading.current_thread() is threading.main_thread():
        # It took SIGTERM for itself, and would end without any cleanup.
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    return pycolmap


def _placed(colmap: Any, folder: Path, lenses: Sequence[Lens], seed: int, say: Say) -> tuple[Any, tuple[str, ...]]:
    """Return COLMAP's largest model of the photographs in a folder, and notes on it.

    Raises SceneError where too few photographs could be placed.
    """
    with tempfile.TemporaryDirectory(prefix="mgsr-poses-") as work:
        model = _largest(_run(colmap, folder, lenses, Path(work), seed, say))
    total = sum(len(lens.shots) for lens in lenses)
    count = model.num_reg_images() if model is not None else 0
    cure = "take more photographs of a still, textured scene, with more overlap"
    if len(lenses) < total:
        cure += "; if these were zoomed or cropped, try `--camera-per-image`"
    notes = check_share(count, total, _LEAST_REGISTERED, "have a camera", cure)
    if model is None or count < 2:
        raise SceneError(f"COLMAP found no camera; {cure}")
    error = model.compute_mean_reprojection_error()
    say(
        f"found cameras of {count} photographs and {model.num_points3D()} points; the mean reprojection error is "
        f"{error:.2f} pixels"
    )
    return model, (*notes, *zoom_note(colmap, model))


def _run(colmap: Any, folder: Path, lenses: Sequence[Lens], work: Path, seed: int, say: Say) -> Sequence[Any]:
    """Run COLMAP's feature extraction, matching and incremental mapping; return its models."""
    colmap.set_random_seed(seed)
    database = work / "database.db"
    names = _write_cameras(colmap, database, folder, lenses)
    say(f"finding features in {len(names)} photographs")
    colmap.extract_features(database, folder, image_names=names)
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    if len(names) <= EXHAUSTIVE_UP_TO:
        say(f"matching {len(names) * (len(names) - 1) // 2} pairs of photographs")
        colmap.match_exhaustive(database, verification_options=verification)
    else:
        say(f"matching each photograph with the next {_FOLLOWING} by name")
        pairing = colmap.SequentialPairingOptions(overlap=_FOLLOWING)
        colmap.match_sequential(database, pairing_options=pairing, verification_options=verification)
    placed = _Counter(len(names), say)
    options = colmap.IncrementalPipelineOptions(random_seed=seed, min_model_size=min(10, len(names)))
    models = colmap.incremental_mapping(
        database, folder, work, options, initial_image_pair_callback=placed.first, next_image_callback=placed.next
    )
    return list(models.values())


def _write_cameras(colmap: Any, database: Path, folder: Path, lenses: Sequence[Lens]) -> list[str]:
    """Write a camera for each lens, and its photographs, into a new COLMAP database; return their names, sorted.

    COLMAP's own modes of camera sharing support neither several lenses in a folder nor EXIF in another file.
    """
    with colmap.Database.open(str(database)) as opened:
        rigs = {}
        for lens in lenses:
            camera = _camera(colmap, folder, lens)
            camera.camera_id = opened.write_camera(camera)
            rig = colmap.Rig()
            rig.add_ref_sensor(camera.sensor_id)
            rig_id = opened.write_rig(rig)
            rigs.update({shot.name: (camera, rig_id) for shot in lens.shots})
        for name in sorted(rigs):
            camera, rig_id = rigs[name]
            image = opened.write_image(colmap.Image(name=name, camera_id=camera.camera_id))
            frame = colmap.Frame(rig_id=rig_id)
            frame.add_data_id(colmap.data_t(camera.sensor_id, image))
            opened.write_frame(frame)
    return sorted(rigs)


def _camera(colmap: Any, folder: Path, lens: Lens) -> Any:
    """Return a COLMAP camera with the focal length that EXIF gives.

    The 35 mm equivalent comes first; else the real focal length with the sensor's size, which COLMAP knows for many
    cameras; else a guess from the image's size.
    """
    focal = lens.tags.focal_pixels(lens.size)
    if focal is None and lens.tags.focal is not None:
        return colmap.infer_camera_from_image(folder / lens.shots[0].name)
    width, height = lens.size
    guess = focal or _FOCAL_FACTOR * max(lens.size)
    camera = colmap.Camera.create_from_model_name(0, _LENS_MODEL, guess, width, height)
    camera.has_prior_focal_length = focal is not None
    return camera


class _Counter:
    """Reports from time to time how many photographs COLMAP has placed."""

    def __init__(self, total: int, say: Say) -> None:
        self._total, self._say = total, say
        self._placed = 0

    def first(self) -> None:
        self._placed = 2

    def next(self) -> None:
        self._placed += 1
        if self._placed % 10 == 0:
            self._say(f"found cameras of {self._placed} of {self._total} photographs")


def _largest(models: Sequence[Any]) -> Any:
    return max(models, key=lambda model: model.num_reg_images(), default=None)
