"""Scenes of Middlebury and NeuS: the real dino, and projection matrices decomposed by OpenCV too."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from mgsr.errors import SceneError
from tests.data.captures import BallCapture
from tests.data.reading import draw, project, read_capture, read_strictly
from tests.optional import present

BALL = BallCapture(views=4, center=np.array([1.0, -2, 3]))

# The README of the data: "The (tight) bounding box for the dino model".
DINO_BOX = np.array([[-0.041897, 0.001126, -0.037845], [0.030897, 0.088227, 0.035495]])


def test_the_real_dino_lies_in_its_bounding_box(shared_data: Path) -> None:
    """Check that in every photograph what exceeds the README's threshold well lies in the projected box.

    It also fills much of the box.
    """
    capture = read_capture(shared_data / "real/middlebury_dino48", "middlebury")
    assert len(capture.photos) == 48
    assert len(capture.photos) == 48 and len(capture.missing) == 363 - 48
    corners = np.array(list(itertools.product(*DINO_BOX.T)))
    for photo in capture.photos[::6]:
        pixels = project(photo, corners)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        bright = np.asarray(Image.open(photo.image).convert("L")) > 0.3 * 255
        rows, cols = np.nonzero(bright)
        within = (cols > low[0]) & (cols < high[0]) & (rows > low[1]) & (rows < high[1])
        assert within.mean() > 0.998  # the backdrop of one view has some bright specks
        assert np.ptp(rows) > 0.5 * min(480, high[1] - low[1])


def middlebury(root: Path, lines: list[str] | None = None) -> Path:
    rows = []
    for i, pose in enumerate(BALL.poses()):
        draw(root / f"v{i}.png")
        rows.append(" ".join(map(str, [f"v{i}.png", *BALL.K.ravel(), *pose[:3, :3].ravel(), *pose[:3, 3]])))
    (root / "v_par.txt").write_text("\n".join([str(len(rows)), *rows] if lines is None else lines))
    return root


def test_middlebury_cameras(tmp_path: Path) -> None:
    for photo, pose in zip(read_capture(middlebury(tmp_path), "middlebury").photos, BALL.poses(), strict=True):
        np.testing.assert_allclose(photo.cam_from_world, pose)
        # Its pixels are counted from the middle of the first.
        np.testing.assert_allclose(photo.K - BALL.K, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])


def test_middlebury_with_a_byte_order_mark_beside_a_file_of_macos(tmp_path: Path) -> None:
    path = middlebury(tmp_path) / "v_par.txt"
    path.write_text(path.read_text(), encoding="utf-8-sig")
    (tmp_path / "._v_par.txt").write_bytes(b"\0\5\x16\7 Mac OS X \xff\xfe")
    assert len(read_capture(tmp_path, "middlebury").photos) == 4


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], r"v_par\.txt is an empty file"),
        (["# none"], r"v_par\.txt: expected the number of further lines \(0\) in the first line"),
        (["3", "v0.png 1 2 3"], r"expected the number of further lines \(1\) in the first line, got '3'"),
        (["1", "v0.png 1 2 3"], "line 2: expected an image's name and 21 numbers .*got 3 numbers"),
        (["1", "v0.png " + "x " * 21], "line 2: could not convert"),
        (["1", "../elsewhere.png " + "1 " * 21], r"\.\./elsewhere\.png is missing"),
    ],
)
def test_middlebury_refusals(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_strictly(middlebury(tmp_path, lines), "middlebury")


def neus(
    root: Path,
    change: Callable[[dict[str, np.ndarray]], object] = lambda matrices: None,
    names: str = "image/{:06d}.png",
    masks: str = "mask/{:03d}.png",
) -> Path:
    matrices: dict[str, Any] = {}
    for i, pose in enumerate(BALL.poses()):
        draw(root / names.format(i))
        draw(root / masks.format(i))
        # Known up to a factor, and with scale_mat as IDR writes it.
        matrices[f"world_mat_{i}"] = np.vstack([-2.5 * BALL.K @ pose[:3], [0, 0, 0, 1]])
        matrices[f"scale_mat_{i}"] = np.diag([3.0, 3, 3, 1])
    change(matrices)
    np.savez(root / "cameras_sphere.npz", **matrices)
    return root


def test_neus_cameras_agree_with_opencvs_decomposition(tmp_path: Path) -> None:
    capture = read_capture(neus(tmp_path), "neus")
    for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
        K, rotation, center, *_ = cv2.decomposeProjectionMatrix(BALL.K @ pose[:3])
        np.testing.assert_allclose(photo.cam_from_world[:3, :3], rotation, atol=1e-9)
        np.testing.assert_allclose(
            photo.K, K / K[2, 2] + [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]], atol=1e-9
        )
        middle = center[:3, 0] / center[3, 0]
        np.testing.assert_allclose(photo.cam_from_world[:3, :3] @ middle + photo.cam_from_world[:3, 3], 0, atol=1e-9)


def test_masks_of_dtu_go_by_their_order(tmp_path: Path) -> None:
    capture = read_capture(neus(tmp_path), "neus")
    assert [present(photo.mask).name for photo in capture.photos] == [f"{i:03d}.png" for i in range(4)]
    assert [photo.image.name for photo in capture.photos] == [f"{i:06d}.png" for i in range(4)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("world_mat_3"), r"it has 3 cameras \(world_mat_0\.\.\.\), but image/ has 4 images"),
        (lambda m: m.pop("world_mat_1"), r"damaged or lacks world_mat_0"),
        (lambda m: m.update(world_mat_1=np.zeros((4, 4))), "world_mat_1 .*has NaN or is singular"),
        (lambda m: m.update(world_mat_1=np.full((4, 4), np.nan)), "world_mat_1 .*has NaN"),
        (
            lambda m: m.update(world_mat_1=np.zeros(3)),
            r"expected a 4x4 projection matrix, got shape \[3\]",
        ),
        (lambda m: m.update(world_mat_1=np.array([{}])), "damaged"),
        (lambda m: m.update(huge=np.zeros(100_000)), "has 800128 bytes, expected at most 65536"),
    ],
)
def test_neus_refusals(tmp_path: Path, change: Callable[..., Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_strictly(neus(tmp_path, change), "neus")


def test_neus_file_that_is_no_archive(tmp_path: Path) -> None:
    neus(tmp_path)
    (tmp_path / "cameras_sphere.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(SceneError, match=r"cameras_sphere\.npz: the file is damaged"):
        read_capture(tmp_path, "neus")


def test_neus_without_images(tmp_path: Path) -> None:
    np.savez(tmp_path / "cameras_sphere.npz", world_mat_0=np.eye(4))
    with pytest.raises(SceneError, match="there are no images in image/ or images/; copy them there"):
        read_capture(tmp_path, "neus")
