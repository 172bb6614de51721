"""Structure from motion with COLMAP (pycolmap): the cameras of photographs, from the photographs alone.

A COLMAP database holds the features of photographs and the matches of pairs. Both are computed in small portions, so
that the search can report, stop and keep its state between two of them; what the database holds already is not computed
again.
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

# A thread holds up to 1 GB for a photograph.
_MOST_THREADS = 8
# Photographs a thread and pairs of photographs between two reports.
_PHOTOS_AT_ONCE = 2
_PAIRS_AT_ONCE = 100

# COLMAP gives up the placing of photographs after so many seconds, and so many more for each photograph.
_MAPPING_SECONDS = 600
_MAPPING_SECONDS_EACH = 30

# Shares of the search that features and then matches have taken when they are complete.
_FEATURES, _MATCHES = 0.35, 0.75


@dataclass(frozen=True)
class SearchFolder:
    """The files of a search.

    images: the folder of the photographs, in forms that COLMAP reads. database: COLMAP's, which may be there already.
    keep: called between two portions of work, when the database may be copied.
    """

    images: Path
    database: Path
    keep: Callable[[], None]


def require_pycolmap() -> None:
    """Raise ConfigError where pycolmap is not installed, before any work."""
    if importlib.util.find_spec("pycolmap") is None:
        raise ConfigError("finding cameras requires pycolmap; install it with `pip install 'mgsr[poses]'`")


def load_pycolmap() -> Any:
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
            f"pycolmap can't be loaded: {in_short(error)}; install it again with `pip install 'mgsr[poses]'`"
        ) from error
    pycolmap.logging.minloglevel = 2  # its errors arrive as exceptions, and its messages are not for our users
    pycolmap.logging.logtostderr = True  # else it leaves files in the folder for temporary ones
    if threading.current_thread() is threading.main_thread():
        # It took SIGTERM for itself, and would end without any cleanup.
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

    frames: whether they are frames of a video. Raises SceneError where too few photographs could be placed, and
    Cancelled where `search.tell` does.
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
    """Run COLMAP's feature extraction, matching and incremental mapping; return its models."""
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
    """Place the photographs one after the other, from their matches; return at most `max_models` models."""
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
    """Write a camera for each lens, and its photographs, into a new COLMAP database.

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
    """Return a COLMAP camera with the focal length that EXIF gives.

    The 35 mm equivalent comes first; else the real focal length with the sensor's size, which COLMAP knows for many
    cameras; else `focal_guess` times the image's longer side.
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
    """Counts and reports the photographs that COLMAP has placed, and stops it where the search is cancelled.

    stopped: the error with which the search was cancelled; an error can't pass through COLMAP itself.
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
            # A later, smaller model begins anew.
            self._search.tell(_MATCHES + (1 - _MATCHES) * min(self._placed / self._total, 1.0))
        except Cancelled as stop:
            self.stopped = stop
            self.token.cancel()
