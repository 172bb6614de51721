"""Lenses held to the libraries that define them: OpenCV and COLMAP."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from mgsr.config.expert import UndistortionOptions
from mgsr.data.formats.colmap import _MODELS, checked_camera, to_pinhole
from mgsr.data.lens import DivisionLens, Lens
from mgsr.data.pixels import PixelStore
from mgsr.data.undistortion import Undistorter, resample, undistortion
from mgsr.errors import SceneError

pycolmap = pytest.importorskip("pycolmap")

HALF_ANGLE = UndistortionOptions().half_angle
RNG = np.random.default_rng(5)
RAYS = np.c_[RNG.uniform(-0.7, 0.7, (40, 2)), np.ones(40)]
K = np.array([[60.0, 0, 47], [0, 70, 31], [0, 0, 1]])
SMALL = {"f": 60, "fx": 60, "fy": 70, "cx": 47, "cy": 31, "omega": 0.8, "alpha": 0.6, "beta": 1.1}


def pixels(lens: Lens) -> np.ndarray:
    distorted: np.ndarray = np.stack(lens.distort(*RAYS[:, :2].T)).T @ K[:2, :2] + K[:2, 2]
    return distorted


def parameters(camera: Any) -> list[float]:
    names = [name.strip() for name in camera.params_info.split(",")]
    return [SMALL.get(name, 0.02 + 0.003 * i) for i, name in enumerate(names)]


@pytest.mark.parametrize("number", [number for number, (name, _) in _MODELS.items() if name != "EQUIRECTANGULAR"])
def test_every_camera_model_agrees_with_colmap(number: int) -> None:
    name, count = _MODELS[number]
    camera = pycolmap.Camera.create_from_model_name(1, name, 60.0, 96, 64)
    assert int(camera.model) == number and len(camera.params) == count
    camera.params = parameters(camera)
    matrix, lens = to_pinhole(checked_camera(name, 96, 64, tuple(camera.params)), "test")
    x, y = RAYS[:, 0], RAYS[:, 1]
    if lens is not None:
        x, y = lens.distort(x, y)
    expected = camera.img_from_cam(RAYS)
    np.testing.assert_allclose(np.c_[x, y] @ matrix[:2, :2].T + matrix[:2, 2], expected, atol=1e-9)


def test_the_polynomial_agrees_with_opencv() -> None:
    terms = np.array([0.1, -0.05, 0.01, -0.02, 0.03, 0.04, -0.02, 0.01, 0.005, -0.004, 0.003, 0.002])
    k1, k2, p1, p2, k3 = terms[:5]
    lens = Lens(k1, k2, p1, p2, higher=(k3,), divisor=tuple(terms[5:8]), prism=tuple(terms[8:]))
    expected, _ = cv2.projectPoints(RAYS, np.zeros(3), np.zeros(3), K, terms)
    np.testing.assert_allclose(
        np.stack(lens.distort(*RAYS[:, :2].T)).T @ K[:2, :2] + K[:2, 2], expected[:, 0], atol=1e-9
    )


def test_the_fisheye_agrees_with_opencv() -> None:
    terms = np.array([0.1, -0.05, 0.02, -0.01])
    lens = Lens(terms[0], terms[1], higher=tuple(terms[2:]), fisheye=True)
    expected, _ = cv2.fisheye.projectPoints(RAYS[:, None], np.zeros(3), np.zeros(3), K, terms)
    np.testing.assert_allclose(
        np.stack(lens.distort(*RAYS[:, :2].T)).T @ K[:2, :2] + K[:2, 2], expected[:, 0], atol=1e-9
    )


@pytest.mark.parametrize("lens", [Lens(), Lens(higher=(0.0, 0.0)), DivisionLens(0.0)])
def test_lenses_that_change_nothing_say_so(lens: Lens | DivisionLens) -> None:
    assert lens.flat
    np.testing.assert_array_equal(lens.distort(*RAYS[:, :2].T), RAYS[:, :2].T)


@pytest.mark.parametrize("lens", [Lens(fisheye=True), Lens(skew=0.1), Lens(higher=(0.0, 0.1))])
def test_lenses_that_change_something_say_so(lens: Lens) -> None:
    assert not lens.flat


def test_the_whole_undistorted_image_agrees_with_opencv() -> None:
    """Check against OpenCV's own maps and remapping of the same photograph, for the same window."""
    image = cv2.GaussianBlur(RNG.random((64, 96, 3)).astype(np.float32), (0, 0), 2)
    how = undistortion(Lens(-0.2, 0.05, 0.01, -0.01), K, 96, 64, "test")
    ours = resample(image, how)
    height, width = ours.shape[:2]
    # OpenCV counts pixels from their middles.
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    terms = np.array([-0.2, 0.05, 0.01, -0.01])
    maps = cv2.initUndistortRectifyMap(K - half, terms, None, how.K - half, (width, height), cv2.CV_32FC1)
    assert how.valid_mask is not None and how.valid_mask.mean() > 0.8
    np.testing.assert_allclose(how.map_x[how.valid_mask], maps[0][how.valid_mask], atol=1e-3)
    expected = cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(ours[how.valid_mask], expected[how.valid_mask], atol=2e-3)


# What a phone, an action camera and a circular fisheye do, and lenses whose polynomial folds back inside the picture.
STRONG = [
    Lens(0.3),
    Lens(-0.35, 0.1, 0.004, -0.006),
    Lens(-0.4),
    Lens(0.05, 0.02, fisheye=True),
    Lens(-0.1, fisheye=True),
    Lens(0.0, skew=0.1),
]


@pytest.mark.parametrize("lens", STRONG)
@pytest.mark.parametrize("focal", [25.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_what_is_known_is_what_the_photograph_shows(lens: Lens, focal: float) -> None:
    """Check that exactly those pixels are known whose ray the photograph shows, and that they lie where they should.

    The kept image and the pixels around it are checked. Where a rectangle was taken instead, it leaves out no more than
    a 30th.
    """
    K = np.array([[focal, 0, 47], [0, 1.1 * focal, 31], [0, 0, 1]])
    how = undistortion(lens, K, 96, 64, "test")
    height, width = how.map_x.shape
    left, top = np.round(K[:2, 2] - how.K[:2, 2]).astype(int)
    rows, cols = np.mgrid[top - 1 : top + height + 1, left - 1 : left + width + 1]
    shown, places, sure = followed(lens, K, (cols.ravel() + 0.5, rows.ravel() + 0.5))
    shown, sure, places = shown.reshape(rows.shape), sure.reshape(rows.shape), places.reshape(*rows.shape, 2)
    inner = (slice(1, -1), slice(1, -1))
    known = np.ones((height, width), bool) if how.valid_mask is None else how.valid_mask
    assert sure.mean() > 0.97
    np.testing.assert_array_equal(known[sure[inner]], shown[inner][sure[inner]])
    np.testing.assert_allclose(np.dstack([how.map_x, how.map_y])[known], places[inner][known] - 0.5, atol=1e-3)
    beyond = (shown & sure).sum() - (shown & sure)[inner].sum()
    assert beyond == 0 if how.valid_mask is not None else beyond < known.sum() / 30


def followed(
    lens: Lens, K: np.ndarray, pixels: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whether the photograph shows what pinhole pixels show up to the half angle, where, and which are certain.

    Uncertain pixels lie on an edge, to a thousandth of a pixel, or within a pixel of a fold. OpenCV projects a ray that
    turns from the axis to the pixel in 400 steps, and must go outwards all the way without leaving the photograph.
    """
    x, y = ((place - K[i, 2]) / K[i, i] for i, place in enumerate(pixels))
    angle = np.degrees(np.arctan(np.hypot(x, y)))
    shown, sure = angle <= HALF_ANGLE, np.abs(angle - HALF_ANGLE) > 1e-3
    before = np.zeros(len(x))
    for step in np.linspace(0, 1, 401)[1:]:
        places = projected(lens, K, np.c_[x * step, y * step, np.ones(len(x))])
        away = np.linalg.norm(places - K[:2, 2], axis=1)
        shown &= (away > before) & (places >= 0).all(axis=1) & (places <= [96, 64]).all(axis=1)
        before = away
    farther = 1 + 1 / np.hypot(x * K[0, 0], y * K[1, 1])
    places_farther = projected(lens, K, np.c_[x * farther, y * farther, np.ones(len(x))])
    sure &= ~shown | (np.linalg.norm(places_farther - K[:2, 2], axis=1) > before)
    sure &= (np.abs(places) > 1e-3).all(axis=1) & (np.abs(places - [96, 64]) > 1e-3).all(axis=1)
    return shown, places, sure


def projected(lens: Lens, K: np.ndarray, rays: np.ndarray) -> np.ndarray:
    terms = np.array([lens.k1, lens.k2, *(lens.higher or (0.0, 0.0))])
    if lens.fisheye:
        skewed = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), K, terms, alpha=lens.skew)
    else:
        skewed = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, np.array([lens.k1, lens.k2, lens.p1, lens.p2]))
    places = skewed[0].reshape(-1, 2)
    if lens.skew and not lens.fisheye:
        places[:, 0] += lens.skew * K[0, 0] / K[1, 1] * (places[:, 1] - K[1, 2])
    return places


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_bytes_are_resampled_as_floats_are(channels: int) -> None:
    """Check sharp noise, on which bicubic interpolation overshoots both ends of a byte."""
    image = RNG.choice(np.array([0, 255], np.uint8), (64, 96, channels))
    how = undistortion(Lens(-0.2), K, 96, 64, "test")
    exact = resample(image.astype(np.float32), how)
    assert exact.min() < -10 and exact.max() > 265 and exact.shape == (*how.map_x.shape, channels)
    np.testing.assert_array_equal(resample(image, how), np.clip(np.rint(exact), 0, 255).astype(np.uint8))


def test_a_lens_without_usable_image_is_refused() -> None:
    with pytest.raises(SceneError, match=r"view 3: the lens distortion .* leaves no usable pixels"):
        undistortion(Lens(k1=-1e6), K, 96, 64, "view 3")


def test_one_map_serves_all_photographs_of_a_camera() -> None:
    undistort = Undistorter(PixelStore())
    assert undistort(Lens(0.1), K, 96, 64, "a") is undistort(Lens(0.1), K.copy(), 96, 64, "b")
    assert undistort(Lens(0.1), K, 96, 64, "a") is not undistort(Lens(0.2), K, 96, 64, "c")
    with pytest.raises(SceneError):
        undistort(Lens(-1e6), K, 96, 64, "d")
    with pytest.raises(SceneError):
        undistort(Lens(-1e6), K, 96, 64, "d")
