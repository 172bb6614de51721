"""Make a scene of photographs that have no cameras, with COLMAP (pycolmap).

The result is a scene folder with images/ and sparse/0.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from mgsr.config import DataConfig
from mgsr.data.archive import unpack
from mgsr.data.camera_search import CameraSearch, Say
from mgsr.data.find_cameras import choose_frames_of, lenses_of
from mgsr.data.gather_photos import find_photos, gather
from mgsr.data.odd_files import is_read_video_name
from mgsr.data.structure_from_motion import SearchFolder, find_model, require_pycolmap
from mgsr.errors import ConfigError


def find_poses(
    photos: Path, scene: Path, seed: int, say: Say = print, camera_per_image: bool = False
) -> tuple[str, ...]:
    """Estimate the cameras of the photographs below `photos`, a folder, an archive or a video, and make a scene.

    The folder `scene` holds COLMAP's largest model in sparse/0 and the photographs in images/. They are hard links
    where the disk allows it, and PNG where COLMAP can't read the originals. The same seed gives the same choices of
    COLMAP's random samples; its threads may still differ in the last digits.

    say: receives a line on each stage. camera_per_image: give each photograph its own lens; otherwise the photographs
    of one camera share a lens. Returns notes on the photographs that could not be placed.

    Raises ConfigError without pycolmap, and if `scene` is not empty. Raises SceneError if most photographs can't be
    read or placed; then no `scene` is left.
    """
    require_pycolmap()
    search = CameraSearch(seed=seed, say=say)
    is_video = photos.is_file() and is_read_video_name(photos)
    if scene.exists() and any(scene.iterdir()):
        raise ConfigError(f"{scene}: the folder is not empty; choose a new folder for the scene")
    with tempfile.TemporaryDirectory(prefix="mgsr-poses-") as work:
        folder = Path(work, "frames") if is_video else unpack(photos) if photos.is_file() else photos
        if is_video:
            choose_frames_of([photos], folder, DataConfig(), search)
        images = find_photos(folder, photos)
        scene.mkdir(parents=True, exist_ok=True)
        try:
            gathered = gather(folder, images, scene / "images")
            for note in gathered.notes:  # said now, because matching may take an hour
                say(note)
            lenses = lenses_of(gathered.shots, camera_per_image, search)
            found = SearchFolder(scene / "images", Path(work, "database.db"), keep=lambda: None)
            model, notes = find_model(found, lenses, is_video, search)
            (scene / "sparse/0").mkdir(parents=True)
            model.write(str(scene / "sparse/0"))
        except BaseException:
            shutil.rmtree(scene, ignore_errors=True)
            raise
    return notes
