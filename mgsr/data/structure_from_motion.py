"""Structure from motion with COLMAP (pycolmap), which finds cameras from the photographs alone.

A COLMAP database holds the features of photographs and the matches of pairs. Both are computed in small portions.
Between two portions, the search can report progress, stop and save its state. COLMAP does not compute again what the
database already holds.
"""

from __future__ import annotations

import importlib
import importlib.util
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mgsr.config.expert import CameraSearchOptions
from mgsr.data.camera_search import CameraSearch, Tell
from mgsr.data.image_pairs import choose_pairs
from mgsr.data.registration import check_share
from mgsr.data.shared_lenses import SharedLens
from mgsr.data.zoom_check import zoom_note
from mgsr.errors import Cancelled, ConfigError, SceneError, in_short
from mgsr.parallel import core_count

_LEAST_REGISTERED = 0.25

# COLMAP's default, with one parameter of distortion.
_LENS_MODEL = "SIMPLE_RADIAL"

# A thread needs up to 1 GB for a photograph.
_MOST_THREADS = 8
# Between two reports: the photographs per thread, and the pairs of photographs.
_PHOTOS_AT_ONCE = 2
_PAIRS_AT_ONCE = 100

# COLMAP's time limit for mapping, in seconds: a constant, and a share for each photograph.
_MAPPING_SECONDS = 600
_MAPPING_SECONDS_EACH = 30

# The progress of the search when all features, and then all matches, are complete.
_FEATURES, _MATCHES = 0.35, 0.75


@dataclass(frozen=True)
class SearchFolder:
    """The files of a search.

    images: the folder of the photographs, in formats that COLMAP reads. database: COLMAP's database, which may exist.
    keep: called between two portions of work, when the database may be copied.
    """

    images: Path
    database: Path
    keep: Callable[[], None]


def require_pycolmap() -> None:
    """Raise ConfigError if pycolmap is not installed, so that a run fails before any work."""
    if importlib.util.find_spec("pycolmap") is None:
        raise ConfigError("finding cameras requires pycolmap; install it with `pip install 'mgsr[poses]'`")


def load_pycolmap() -> Any:
    """Import pycolmap, and set its logging and signal handlers as MGSR needs them.

    pycolmap bundles its own OpenImageIO, and the copy that is loaded second uses parts of the first. If ours is the
    second, the process crashes as soon as it refuses a file, so it is loaded first. pycolmap's copy must never get a
    file that it would refuse. Raises ConfigError if pycolmap can't be loaded.
    """
    importlib.import_module("OpenImageIO")
    try:
        import pycolmap
    except ImportError as error:
        raise ConfigError(
            f"pycolmap can't be loaded: {in_short(error)}; install it again with `pip install 'mgsr[poses]'`"
        ) from error
    pycolmap.logging.minloglevel = 2  # its errors arrive as exceptions, and its messages are not for our users
    pycolmap.logging.logtostderr = True  # otherwise it leaves log files in the temporary folder
    if threading.current_thread() is threading.main_thread():
        # pycolmap installs its own handler of SIGTERM, which would end the process without any cleanup.
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
    return pycolmap


def find_model(
    folder: SearchFolder,
    lenses: Sequence[SharedLens],
    frames: bool,
    search: CameraSearch,
    options: CameraSearchOptions = CameraSearchOptions(),
) -> tuple[Any, tuple[str, ...]]:
    """Return COLMAP's largest model of the photographs, a pycolmap.Reconstruction, and notes on it.

    frames: whether the photographs are frames of a video. Raises SceneError if too few photographs could be placed, and
    passes on Cancelled from `search.tell`.
    """
    colmap = load_pycolmap()
    model = max(
        _models(colmap, folder, lenses, frames, search, options),
        key=lambda each: each.num_reg_images(),
        default=None,
    )
    total = sum(len(lens.shots) for lens in lenses)
    count = model.num_reg_images() if model is not None else 0
    cure = "take more photographs of a still, textured scene, with more overlap"
    if frames:
        cure = "film again, slower, with more texture in view, and walk around the object"
    elif len(lenses) < total:
        cure += "; if these were zoomed or cropped, try `--set camera_per_image=on`"
    notes = check_share(count, total, _LEAST_REGISTERED, "have a camera", cure)
    if model is None or count < 2:
        raise SceneError(f"COLMAP found no camera; {cure}")
    error = model.compute_mean_reprojection_error()
    search.say(
        f"found cameras of {count} photographs and {model.num_points3D()} points; the mean reprojection error is "
        f"{error:.2f} pixels"
    )
    return model, (*notes, *zoom_note(colmap, model, options.zoom))


def _models(
    colmap: Any,
    folder: SearchFolder,
    lenses: Sequence[SharedLens],
    frames: bool,
    search: CameraSearch,
    options: CameraSearchOptions,
) -> Sequence[Any]:
    """Run COLMAP's feature extraction, matching and incremental mapping, and return its models."""
    colmap.set_random_seed(search.seed)
    names = sorted(shot.name for lens in lenses for shot in lens.shots)
    if not folder.database.exists():
        write_cameras(colmap, folder.database, folder.images, lenses, options)
    search.say(f"finding features in {len(names)} photographs")
    _find_features(colmap, folder, names, search.share(0, _FEATURES), options)
    work = folder.database.parent
    pairs = choose_pairs(colmap, folder.database, names, frames, work, search.seed, options.pairs)
    search.say(f"matching {len(pairs)} pairs of photographs")
    _match(colmap, folder, pairs, search.seed, search.share(_FEATURES, _MATCHES))
    return _place(colmap, folder, len(names), search, options.max_models)


def _find_features(
    colmap: Any, folder: SearchFolder, names: Sequence[str], tell: Tell, options: CameraSearchOptions
) -> None:
    threads = min(_MOST_THREADS, core_count(None))
    extraction = colmap.FeatureExtractionOptions(max_image_size=options.feature_side, num_threads=threads)
    extraction.sift.peak_threshold = options.peak
    portion = threads * _PHOTOS_AT_ONCE
    for first in range(0, len(names), portion):
        tell(first / len(names))
        portion_names = names[first : first + portion]
        colmap.extract_features(
            folder.database, folder.images, image_names=portion_names, extraction_options=extraction
        )
        folder.keep()


def _match(colmap: Any, folder: SearchFolder, pairs: Sequence[tuple[str, str]], seed: int, tell: Tell) -> None:
    matching = colmap.FeatureMatchingOptions(num_threads=min(_MOST_THREADS, core_count(None)))
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    listed = folder.database.with_name("pairs.txt")
    pairing = colmap.ImportedPairingOptions(match_list_path=listed)
    for first in range(0, len(pairs), _PAIRS_AT_ONCE):
        tell(first / len(pairs))
        listed.write_text("".join(f"{one} {other}\n" for one, other in pairs[first : first + _PAIRS_AT_ONCE]))
        colmap.match_image_pairs(
            folder.database, matching_options=matching, pairing_options=pairing, verification_options=verification
        )
        folder.keep()


def _place(colmap: Any, folder: SearchFolder, count: int, search: CameraSearch, max_models: int) -> Sequence[Any]:
    """Run incremental mapping on the matches, and return at most `max_models` models."""
    options = colmap.IncrementalPipelineOptions(
        random_seed=search.seed,
        min_model_size=min(10, count),
        max_num_models=max_models,
        max_runtime_seconds=_MAPPING_SECONDS + _MAPPING_SECONDS_EACH * count,
    )
    placed = _Counter(count, search, colmap.CancellationToken())
    try:
        models = colmap.incremental_mapping(
            folder.database,
            folder.images,
            folder.database.parent,
            options,
            initial_image_pair_callback=placed.first,
            next_image_callback=placed.next,
            cancellation_token=placed.token,
        )
    except InterruptedError:
        raise placed.stopped or Cancelled("stopped on request") from None
    if placed.stopped is not None:
        raise placed.stopped
    return list(models.values())


def write_cameras(
    colmap: Any,
    database: Path,
    folder: Path,
    lenses: Sequence[SharedLens],
    options: CameraSearchOptions = CameraSearchOptions(),
) -> None:
    """Create a COLMAP database with one camera per lens, and its photographs.

    COLMAP's own modes of camera sharing support neither several lenses in a folder nor EXIF in another file.
    """
    with colmap.Database.open(str(database)) as opened:
        rigs = {}
        for lens in lenses:
            camera = _camera(colmap, folder, lens, options.focal_guess)
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


def _camera(colmap: Any, folder: Path, lens: SharedLens, focal_guess: float) -> Any:
    """Return a COLMAP camera with the focal length from EXIF.

    The 35 mm equivalent comes first, then the real focal length with the sensor's size, which COLMAP knows for many
    cameras. Without EXIF, the focal length is `focal_guess` times the image's longer side.
    """
    focal = lens.tags.focal_pixels(lens.size)
    if focal is None and lens.tags.focal is not None:
        return colmap.infer_camera_from_image(folder / lens.shots[0].name)
    width, height = lens.size
    guess = focal or focal_guess * max(lens.size)
    camera = colmap.Camera.create_from_model_name(0, _LENS_MODEL, guess, width, height)
    camera.has_prior_focal_length = focal is not None
    return camera


class _Counter:
    """Callbacks that count and report the photographs that COLMAP has placed, and stop it if the search is cancelled.

    stopped: the error of the cancelled search, kept here because an exception can't pass through COLMAP.
    """

    def __init__(self, total: int, search: CameraSearch, token: Any) -> None:
        self._total, self._search, self._placed = total, search, 0
        self.token = token
        self.stopped: Cancelled | None = None

    def first(self) -> None:
        self._placed = 2

    def next(self) -> None:
        self._placed += 1
        try:
            # If COLMAP begins another model, it counts photographs again, hence the limit.
            self._search.tell(_MATCHES + (1 - _MATCHES) * min(self._placed / self._total, 1.0))
        except Cancelled as stop:
            self.stopped = stop
            self.token.cancel()
