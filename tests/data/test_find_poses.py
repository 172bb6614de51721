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

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from pillow_heif import from_pillow

from mgsr.data.find_poses import _write_cameras, find_poses
from mgsr.data.gather_photos import gather
from mgsr.data.shared_lenses import share_lenses
from mgsr.errors import ConfigError, SceneError
from tests.data.captures import look_at
from tests.data.reading import draw, read_capture

importlib.import_module("OpenImageIO")  # before pycolmap, as in the program: the two don't bear the other order
pycolmap = pytest.importorskip("pycolmap")

WIDTH, HEIGHT = 320, 240
K = np.array([[300.0, 0, WIDTH / 2], [0, 300, HEIGHT / 2], [0, 0, 1]])
TEXTURE = 512
# The corner's sides: the origin and the edges of each square, 4 units long.
SIDES = [
    ([-2, -2, -1], [4, 0, 0], [0, 4, 0]),
    ([-2, 2, -1], [4, 0, 0], [0, 0, 4]),
    ([-2, -2, -1], [0, 4, 0], [0, 0, 4]),
]


def poses() -> list[np.ndarray]:
    turns = np.linspace(0.15, 1.35, 8)
    eyes = [[5 * np.sin(turn), -5 * np.cos(turn), 2 + 0.3 * np.sin(5 * turn)] for turn in turns]
    return [look_at(np.array(eye), np.array([-0.6, 0.6, 0.3])) for eye in eyes]


def picture(pose: np.ndarray) -> np.ndarray:
    """Draw the nearer sides over the farther ones; they meet in edges, so that their order doesn't matter."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for seed, (origin, across, down) in enumerate(SIDES):
        noise = np.random.default_rng(seed).integers(0, 256, (64, 64, 3), dtype=np.uint8)
        texture = cv2.resize(noise, (TEXTURE, TEXTURE), interpolation=cv2.INTER_CUBIC)
        plane = np.stack([np.array(across) / TEXTURE, np.array(down) / TEXTURE, np.array(origin)], axis=1)
        homography = K @ (pose[:3, :3] @ plane + np.outer(pose[:3, 3], [0, 0, 1]))
        drawn = cv2.warpPerspective(texture, homography, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        seen = cv2.warpPerspective(np.full((TEXTURE, TEXTURE), 255, np.uint8), homography, (WIDTH, HEIGHT)) > 127
        image[seen] = drawn[seen]
    return image


def aligned(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rotation and scale that take centred points to others (Kabsch)."""
    found, true = found - found.mean(0), true - true.mean(0)
    left, _, right = np.linalg.svd(true.T @ found)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return rotation, float(np.sqrt((true**2).sum() / (found**2).sum()))


@pytest.mark.slow
def test_cameras_are_found_up_to_the_frame(tmp_path: Path) -> None:
    for i, pose in enumerate(poses()):
        path = tmp_path / f"photos/{i}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), picture(pose))
    said: list[str] = []
    assert find_poses(tmp_path / "photos", tmp_path / "scene", 0, said.append) == ()
    assert said[:2] == ["one camera: 320x240", "finding features in 8 photographs"]
    assert said[-1].startswith("found cameras of 8 photographs and")
    photos = sorted(read_capture(tmp_path / "scene", "colmap").photos, key=lambda photo: photo.image)
    found = np.array([photo.cam_from_world for photo in photos])
    true = np.array(poses())
    centers = [-np.einsum("nji,nj->ni", item[:, :3, :3], item[:, :3, 3]) for item in (found, true)]
    turn, scale = aligned(*centers)
    rest = scale * (centers[0] - centers[0].mean(0)) @ turn.T - (centers[1] - centers[1].mean(0))
    assert np.abs(rest).max() < 0.05, "one per cent of the distance"
    for ours, theirs in zip(found[:, :3, :3], true[:, :3, :3], strict=True):
        assert np.degrees(np.arccos(np.clip((np.trace(ours @ turn.T @ theirs.T) - 1) / 2, -1, 1))) < 1
    assert all(abs(photo.K[0, 0] / 300 - 1) < 0.02 for photo in photos)
    assert len({photo.K[0, 0] for photo in photos}) == 1, "one lens"


@pytest.mark.parametrize(
    ("camera_per_image", "cameras", "cure"),
    [
        (False, "one camera: ", r"with more overlap; if these were zoomed or cropped, try `--camera-per-image`$"),
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
    names = _write_cameras(pycolmap, tmp_path / "new.db", tmp_path / "images", share_lenses(gathered.shots))
    assert names == ["a.jpg", "b.jpg", "c.png", "d.jpg", "e.png"]
    with contextlib.closing(sqlite3.connect(tmp_path / "new.db")) as database:
        images = dict(database.execute("SELECT name, camera_id FROM images"))
        cameras = {row[0]: row[1:] for row in database.execute("SELECT * FROM cameras")}
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
        "import os, signal; from mgsr.data.find_poses import _pycolmap\n"
        "def end(*given): raise SystemExit(143)\n"
        "signal.signal(signal.SIGTERM, end); _pycolmap(); os.kill(os.getpid(), signal.SIGTERM)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ran.returncode, ran.stderr) == (143, "")
