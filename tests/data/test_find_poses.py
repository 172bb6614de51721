"""Cameras found by COLMAP in pictures of a room's corner that are drawn by OpenCV's homographies."""

from __future__ import annotations

import contextlib
import importlib
import sqlite3
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from pillow_heif import from_pillow

from mgsr.data.find_poses import find_poses
from mgsr.data.gather_photos import gather
from mgsr.data.shared_lenses import share_lenses
from mgsr.data.structure_from_motion import write_cameras
from mgsr.errors import ConfigError, SceneError
from tests.data.corner import camera_errors, poses, save_pictures
from tests.data.reading import draw, read_capture

importlib.import_module("OpenImageIO")  # before pycolmap, as in the program: the two don't bear the other order
pycolmap = pytest.importorskip("pycolmap")


@pytest.mark.slow
def test_cameras_are_found_up_to_the_frame(tmp_path: Path) -> None:
    save_pictures(tmp_path / "photos")
    said: list[str] = []
    assert find_poses(tmp_path / "photos", tmp_path / "scene", 0, said.append) == ()
    assert said[:2] == ["one camera: 320x240", "finding features in 8 photographs"]
    assert said[-1].startswith("found cameras of 8 photographs and")
    photos = sorted(read_capture(tmp_path / "scene", "colmap").photos, key=lambda photo: photo.image)
    place, turn = camera_errors(np.array([photo.cam_from_world for photo in photos]), np.array(poses()))
    assert place.max() < 0.05, "one per cent of the distance"
    assert turn.max() < 1
    assert all(abs(photo.K[0, 0] / 300 - 1) < 0.02 for photo in photos)
    assert len({photo.K[0, 0] for photo in photos}) == 1, "one lens"


@pytest.mark.parametrize(
    ("camera_per_image", "cameras", "cure"),
    [
        (
            False,
            "one camera: ",
            r"with more overlap; if these were zoomed or cropped, try `--set camera_per_image=on`$",
        ),
        (True, "a separate camera for each photograph", "with more overlap$"),
    ],
)
def test_pictures_without_texture_leave_nothing_behind(
    tmp_path: Path, camera_per_image: bool, cameras: str, cure: str
) -> None:
    for i in range(4):
        draw(tmp_path / f"photos/{i}.png")
    said: list[str] = []
    with pytest.raises(SceneError, match=rf"only 0 of 4 photographs have a camera; take more photographs.*{cure}"):
        find_poses(tmp_path / "photos", tmp_path / "scene", 0, said.append, camera_per_image)
    assert said[0].startswith(cameras)
    assert not (tmp_path / "scene").exists()


def test_cameras_in_the_database_are_shared_and_know_what_exif_says(tmp_path: Path) -> None:
    """Check the database by SQLite, in the layout of COLMAP's documentation ("Database Format")."""
    equivalent = {0xA405: 26}  # Exif 2.32: FocalLengthIn35mmFilm
    real = {0x920A: IFDRational(42, 10)}  # FocalLength; COLMAP knows the sensor's size of 5.76 mm
    for name, tags in (("a.jpg", equivalent), ("b.jpg", equivalent), ("c.heic", equivalent), ("d.jpg", real)):
        save_photo(tmp_path / "photos" / name, {0x010F: "Apple", 0x0110: "iPhone 12"}, tags)
    save_photo(tmp_path / "photos/e.png", {}, {})
    gathered = gather(tmp_path / "photos", sorted((tmp_path / "photos").iterdir()), tmp_path / "images")
    write_cameras(pycolmap, tmp_path / "new.db", tmp_path / "images", share_lenses(gathered.shots))
    with contextlib.closing(sqlite3.connect(tmp_path / "new.db")) as database:
        images = dict(database.execute("SELECT name, camera_id FROM images"))
        cameras = {row[0]: row[1:] for row in database.execute("SELECT * FROM cameras")}
    assert sorted(images) == ["a.jpg", "b.jpg", "c.png", "d.jpg", "e.png"]
    assert images["a.jpg"] == images["b.jpg"] == images["c.png"], "the HEIC lost its EXIF in conversion, not its lens"
    assert len({images[name] for name in ("a.jpg", "d.jpg", "e.png")}) == len(cameras) == 3
    for name, focal, known in (("a.jpg", 26 / 43.27 * 500, 1), ("d.jpg", 4.2 / 5.76 * 400, 1), ("e.png", 480, 0)):
        model, width, height, params, prior = cameras[images[name]]
        assert (model, width, height, prior) == (2, 400, 300, known), "2 is SIMPLE_RADIAL"
        assert np.frombuffer(params) == pytest.approx([focal, 200, 150, 0], rel=1e-5)
    by_colmap = pycolmap.infer_camera_from_image(tmp_path / "images/a.jpg")
    assert by_colmap.focal_length == pytest.approx(26 / 43.27 * 500), "as COLMAP itself"


def save_photo(path: Path, main: dict[int, Any], more: dict[int, Any]) -> None:
    tags = Image.Exif()
    tags.update(main)
    tags.get_ifd(0x8769).update(more)
    path.parent.mkdir(exist_ok=True)
    image = Image.new("RGB", (400, 300))
    if path.suffix == ".heic":
        from_pillow(image).save(path, exif=tags.tobytes())
    else:
        image.save(path, exif=tags.tobytes() if main else b"")


def test_too_few_photographs(tmp_path: Path) -> None:
    draw(tmp_path / "a.png")
    with pytest.raises(SceneError, match="1 images, but at least 3 are needed"):
        find_poses(tmp_path, tmp_path / "scene", 0)


def test_an_archive_of_too_few_photographs(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "photos.zip", "w") as out:
        for i in range(2):
            draw(tmp_path / f"{i}.png")
            out.write(tmp_path / f"{i}.png", f"holiday/{i}.png")
    with pytest.raises(SceneError, match=r"photos\.zip: it holds 2 images, but at least 3 are needed"):
        find_poses(tmp_path / "photos.zip", tmp_path / "scene", 0)


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    for i in range(4):
        draw(tmp_path / f"photos/{i}.png")
    with pytest.raises(ConfigError, match="photos: the folder is not empty; choose a new folder"):
        find_poses(tmp_path / "photos", tmp_path / "photos", 0)
    assert len(list((tmp_path / "photos").iterdir())) == 4


def test_without_pycolmap_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ConfigError, match=r"requires pycolmap; install it with `pip install 'mgsr\[poses\]'`"):
        find_poses(tmp_path, tmp_path / "scene", 0)


def test_sigterm_stays_ours_beside_colmap() -> None:
    """Check that SIGTERM reaches our handler.

    COLMAP's log library ends the process otherwise, and leaves a call trace and temporary files.
    """
    code = (
        "import os, signal; from mgsr.data.structure_from_motion import load_pycolmap\n"
        "def end(*given): raise SystemExit(143)\n"
        "signal.signal(signal.SIGTERM, end); load_pycolmap(); os.kill(os.getpid(), signal.SIGTERM)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ran.returncode, ran.stderr) == (143, "")
