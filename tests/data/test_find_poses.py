"""Cameras found by COLMAP in pictures of a room's corner that are drawn by OpenCV's homographies."""

from __future__ import annotations

import subprocess
import sys
import zipfile

import cv2
import numpy as np
import pytest
from PIL import Image
from pillow_heif import from_pillow

from mgsr.data.find_poses import _gather, find_poses
from mgsr.errors import ConfigError, SceneError
from tests.data.captures import look_at
from tests.data.reading import draw, read_capture

pytest.importorskip("pycolmap")

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
    """The nearer sides over the farther ones; they meet in edges, so that their order doesn't matter."""
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
    """The rotation and scale that take centred points to others (Kabsch)."""
    found, true = found - found.mean(0), true - true.mean(0)
    left, _, right = np.linalg.svd(true.T @ found)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return rotation, float(np.sqrt((true**2).sum() / (found**2).sum()))


@pytest.mark.slow
def test_cameras_are_found_up_to_the_frame(tmp_path):
    for i, pose in enumerate(poses()):
        path = tmp_path / f"photos/{i}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), picture(pose))
    said = []
    assert find_poses(tmp_path / "photos", tmp_path / "scene", 0, said.append) == ()
    assert said[0] == "finding features in 8 photographs" and said[-1].startswith("8 photographs placed")
    photos = sorted(read_capture(tmp_path / "scene", "colmap").photos, key=lambda photo: photo.image)
    found = np.array([photo.cam_from_world for photo in photos])
    true = np.array(poses())
    centers = [-np.einsum("nji,nj->ni", item[:, :3, :3], item[:, :3, 3]) for item in (found, true)]
    turn, scale = aligned(*centers)
    rest = scale * (centers[0] - centers[0].mean(0)) @ turn.T - (centers[1] - centers[1].mean(0))
    assert np.abs(rest).max() < 0.05, "one per cent of the distance"
    for ours, theirs in zip(found[:, :3, :3], true[:, :3, :3], strict=True):
        assert np.degrees(np.arccos(np.clip((np.trace(ours @ turn.T @ theirs.T) - 1) / 2, -1, 1))) < 1
    assert all(abs(photo.K[0, 0] / 300 - 1) < 0.05 for photo in photos)


def test_pictures_without_texture_leave_nothing_behind(tmp_path):
    for i in range(4):
        draw(tmp_path / f"photos/{i}.png")
    with pytest.raises(SceneError, match="only 0 of 4 photographs could be placed; take more photographs"):
        find_poses(tmp_path / "photos", tmp_path / "scene", 0, lambda text: None)
    assert not (tmp_path / "scene").exists()


def test_too_few_photographs(tmp_path):
    draw(tmp_path / "a.png")
    with pytest.raises(SceneError, match="1 images; at least 3 are needed"):
        find_poses(tmp_path, tmp_path / "scene", 0)


def test_an_archive_of_too_few_photographs(tmp_path):
    with zipfile.ZipFile(tmp_path / "photos.zip", "w") as out:
        for i in range(2):
            draw(tmp_path / f"{i}.png")
            out.write(tmp_path / f"{i}.png", f"holiday/{i}.png")
    with pytest.raises(SceneError, match=r"photos\.zip: 2 images; at least 3 are needed"):
        find_poses(tmp_path / "photos.zip", tmp_path / "scene", 0)


def test_what_colmap_does_not_read_is_converted(tmp_path):
    """Also HEIC that is named .jpg."""
    for name in ("a.heic", "b.jpg"):
        from_pillow(Image.new("RGB", (32, 24), (200, 100, 50))).save(tmp_path / "written.heic")
        (tmp_path / "written.heic").rename(tmp_path / name)
    draw(tmp_path / "c.png")
    images = [tmp_path / name for name in ("a.heic", "b.jpg", "c.png")]
    assert _gather(tmp_path, images, tmp_path / "images") == ["a.png", "b.png", "c.png"]
    for name in ("a.png", "b.png"):
        with Image.open(tmp_path / "images" / name) as image:
            assert image.format == "PNG"
            assert np.abs(np.subtract(image.getpixel((9, 9)), (200, 100, 50))).max() <= 3, "what lossy coding does"
    assert (tmp_path / "images/c.png").samefile(tmp_path / "c.png")


def test_a_folder_that_holds_something_is_left_alone(tmp_path):
    for i in range(4):
        draw(tmp_path / f"photos/{i}.png")
    with pytest.raises(ConfigError, match="photos: is not empty; name a new folder"):
        find_poses(tmp_path / "photos", tmp_path / "photos", 0)
    assert len(list((tmp_path / "photos").iterdir())) == 4


def test_without_pycolmap_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ConfigError, match=r"needs pycolmap; install it with `pip install 'mgsr\[poses\]'`"):
        find_poses(tmp_path, tmp_path / "scene", 0)


def test_sigterm_stays_ours_beside_colmap():
    """Its log library ends the process otherwise, and leaves a trace of calls and temporary files."""
    code = (
        "import os, signal; from mgsr.data.find_poses import _pycolmap\n"
        "def end(*given): raise SystemExit(143)\n"
        "signal.signal(signal.SIGTERM, end); _pycolmap(); os.kill(os.getpid(), signal.SIGTERM)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ran.returncode, ran.stderr) == (143, "")
