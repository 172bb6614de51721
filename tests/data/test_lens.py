"""Lenses held to the libraries that define them: OpenCV and COLMAP."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mgsr.data.formats.colmap import _MODELS, _Camera, _to_pinhole
from mgsr.data.lens import DivisionLens, Lens
from mgsr.data.undistortion import Undistorter, resample, undistortion
from mgsr.errors import SceneError

pycolmap = pytest.importorskip("pycolmap")

RNG = np.random.default_rng(5)
RAYS = np.c_[RNG.uniform(-0.7, 0.7, (40, 2)), np.ones(40)]
K = np.array([[60.0, 0, 47], [0, 70, 31], [0, 0, 1]])
SMALL = {"f": 60, "fx": 60, "fy": 70, "cx": 47, "cy": 31, "omega": 0.8, "alpha": 0.6, "beta": 1.1}


def pixels(lens: Lens) -> np.ndarray:
    return np.stack(lens.distort(*RAYS[:, :2].T)).T @ K[:2, :2] + K[:2, 2]


def parameters(camera) -> list[float]:
    names = [name.strip() for name in camera.params_info.split(",")]
    return [SMALL.get(name, 0.02 + 0.003 * i) for i, name in enumerate(names)]


@pytest.mark.parametrize("number", [number for number, (name, _) in _MODELS.items() if name != "EQUIRECTANGULAR"])
def test_every_camera_model_agrees_with_colmap(number):
    name, count = _MODELS[number]
    camera = pycolmap.Camera.create_from_model_name(1, name, 60.0, 96, 64)
    assert int(camera.model) == number and len(camera.params) == count
    camera.params = parameters(camera)
    matrix, lens = _to_pinhole(_Camera(name, 96, 64, tuple(camera.params)), "test")
    x, y = RAYS[:, 0], RAYS[:, 1]
    if lens is not None:
        x, y = lens.distort(x, y)
    expected = camera.img_from_cam(RAYS)
    np.testing.assert_allclose(np.c_[x, y] @ matrix[:2, :2].T + matrix[:2, 2], expected, atol=1e-9)


def test_the_polynomial_agrees_with_opencv():
    terms = np.array([0.1, -0.05, 0.01, -0.02, 0.03, 0.04, -0.02, 0.01, 0.005, -0.004, 0.003, 0.002])
    lens = Lens(*terms[:4], higher=(terms[4],), divisor=tuple(terms[5:8]), prism=tuple(terms[8:]))
    expected, _ = cv2.projectPoints(RAYS, np.zeros(3), np.zeros(3), K, terms)
    np.testing.assert_allclose(
        np.stack(lens.distort(*RAYS[:, :2].T)).T @ K[:2, :2] + K[:2, 2], expected[:, 0], atol=1e-9
    )


def test_the_fisheye_agrees_with_opencv():
    terms = np.array([0.1, -0.05, 0.02, -0.01])
    lens = Lens(terms[0], terms[1], higher=tuple(terms[2:]), fisheye=True)
    expected, _ = cv2.fisheye.projectPoints(RAYS[:, None], np.zeros(3), np.zeros(3), K, terms)
    np.testing.assert_allclose(
        np.stack(lens.distort(*RAYS[:, :2].T)).T @ K[:2, :2] + K[:2, 2], expected[:, 0], atol=1e-9
    )


@pytest.mark.parametrize("lens", [Lens(), Lens(higher=(0.0, 0.0)), DivisionLens(0.0)])
def test_lenses_that_change_nothing_say_so(lens):
    assert lens.flat
    np.testing.assert_array_equal(lens.distort(*RAYS[:, :2].T), RAYS[:, :2].T)


@pytest.mark.parametrize("lens", [Lens(fisheye=True), Lens(skew=0.1), Lens(higher=(0.0, 0.1))])
def test_lenses_that_change_something_say_so(lens):
    assert not lens.flat


def test_the_whole_undistorted_image_agrees_with_opencv():
    """OpenCV's own maps and remapping of the same photograph, cut to the same window."""
    image = cv2.GaussianBlur(RNG.random((64, 96, 3)).astype(np.float32), (0, 0), 2)
    how = undistortion(Lens(-0.2, 0.05, 0.01, -0.01), K, 96, 64, "test")
    ours = resample(image, how)
    height, width = ours.shape[:2]
    # OpenCV counts pixels from their middles.
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    terms = np.array([-0.2, 0.05, 0.01, -0.01])
    maps = cv2.initUndistortRectifyMap(K - half, terms, None, how.K - half, (width, height), cv2.CV_32FC1)
    np.testing.assert_allclose(how.source_x - 0.5, maps[0], atol=1e-3)
    np.testing.assert_allclose(
        ours, cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), atol=2e-3
    )


def test_no_pixel_is_kept_that_the_photograph_does_not_show():
    """Each kept pixel's ray lies in the photograph, and one step further out on every cut side, one doesn't."""
    how = undistortion(Lens(0.3), K, 96, 64, "test")
    assert how.source_x.min() >= 0 and how.source_x.max() <= 96
    assert how.source_y.min() >= 0 and how.source_y.max() <= 64
    height, width = how.source_x.shape
    left, top = K[:2, 2] - how.K[:2, 2]
    assert (left, top) != (0, 0) and (width, height) != (96, 64)
    y = (np.arange(top, top + height) + 0.5 - K[1, 2]) / K[1, 1]
    x = (left - 0.5 - K[0, 2]) / K[0, 0]
    bent = np.stack(Lens(0.3).distort(np.full(height, x), y)).T * K[[0, 1], [0, 1]] + K[:2, 2]
    assert ((bent < 0) | (bent > [96, 64])).any()


def test_a_lens_without_usable_image_is_refused():
    with pytest.raises(SceneError, match=r"view 3: the lens distortion .* leaves no usable image"):
        undistortion(Lens(k1=-1e6), K, 96, 64, "view 3")


def test_one_map_serves_all_photographs_of_a_camera():
    undistort = Undistorter()
    assert undistort(Lens(0.1), K, 96, 64, "a") is undistort(Lens(0.1), K.copy(), 96, 64, "b")
    assert undistort(Lens(0.1), K, 96, 64, "a") is not undistort(Lens(0.2), K, 96, 64, "c")
    with pytest.raises(SceneError):
        undistort(Lens(-1e6), K, 96, 64, "d")
    with pytest.raises(SceneError):
        undistort(Lens(-1e6), K, 96, 64, "d")
