"""Photometric bundle adjustment, on photographs of a painted ball whose true cameras are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgsr.config.expert import BundleAdjustmentOptions
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.geometry.raycast import RayCaster, pixel_rays
from mgsr.start import bundle_adjustment
from mgsr.start.bundle_adjustment import AdjustedCameras, adjust_cameras
from mgsr.start.scene_depths import DepthMaps
from mgsr.stereo.patch_match import DepthMap
from tests.mesh.shapes import cameras_around
from tests.stereo.pressed_ball import pressed

CAMERAS = cameras_around(24, side=160)
CASTER = RayCaster(pressed().vertices, pressed().faces)
OPTIONS = BundleAdjustmentOptions(cell=4)  # the photographs are small
# Structure from motion errs by about half a pixel: 0.5 pixels here are 0.2 degrees, and 0.01 at the ball.
TURN, SHIFT = np.radians(0.15), 0.006


def photograph(name: str, camera: Camera) -> View:
    """Photograph the pressed ball with blotches of 5 to 12 pixels in front of black."""
    hits = CASTER.cast(camera)
    places = camera.center + pixel_rays(camera) * hits.depth[..., None]
    draw = np.random.default_rng(2)
    waves = draw.normal(size=(40, 3))
    waves *= 70 * 2 * np.pi / draw.uniform(5, 12, 40)[:, None] / np.linalg.norm(waves, axis=1, keepdims=True)
    value = np.sin(places @ waves.T + draw.uniform(0, 6, 40)).sum(axis=-1)
    image = np.clip(110 + 14 * value, 0, 255)[..., None] * [1.0, 0.8, 0.7] * hits.mask[..., None]
    return View(name, camera, np.round(image).astype(np.uint8))


def shaken(camera: Camera, draw: np.random.Generator) -> Camera:
    """Return a camera with an error."""
    change = np.eye(4)
    change[:3, :3] = Rotation.from_rotvec(TURN * draw.standard_normal(3)).as_matrix()
    change[:3, 3] = SHIFT * draw.standard_normal(3)
    return replace(camera, cam_from_world=change @ camera.cam_from_world)


def error(cameras: Sequence[Camera], true: Sequence[Camera]) -> float:
    """Return the deviation in pixels of points' places in the photographs after the best similarity.

    The similarity is that of points of the object: each is placed where the rays of all cameras meet best.
    """
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (100, 3))
    shown = [camera.project(points)[0] for camera in true]
    rows, right = [], []
    for camera, pixels in zip(cameras, shown, strict=True):
        projection = camera.K @ camera.cam_from_world[:3]
        rows.append(pixels[..., None] * projection[2, :3] - projection[:2, :3])
        right.append(projection[:2, 3] - pixels * projection[2, 3])
    matrix, offset = np.concatenate(rows, axis=1), np.concatenate(right, axis=1)
    met = np.stack([np.linalg.lstsq(each, other, rcond=None)[0] for each, other in zip(matrix, offset, strict=True)])
    off = [camera.project(met)[0] - pixels for camera, pixels in zip(cameras, shown, strict=True)]
    return float(np.sqrt((np.array(off) ** 2).sum(axis=-1).mean()))


def split(views: Sequence[View]) -> tuple[list[View], list[View]]:
    """Return training and test views."""
    return [view for index, view in enumerate(views) if index % 8], list(views[::8])


@pytest.fixture(scope="module")
def true() -> list[View]:
    return [photograph(str(index), camera) for index, camera in enumerate(CAMERAS)]


@pytest.fixture(scope="module")
def erring(true: list[View]) -> list[View]:
    draw = np.random.default_rng(5)
    return [replace(view, camera=shaken(view.camera, draw)) for view in true]


def depths_of(views: list[View], true: list[View]) -> DepthMaps:
    """Return depth maps that err by 0.3% at views whose true cameras are known."""
    draw, maps = np.random.default_rng(7), []
    for view in true:
        hits = CASTER.cast(view.camera)
        depth = np.where(hits.mask, hits.depth * (1 + 0.003 * draw.standard_normal(hits.depth.shape)), 0)
        maps.append(DepthMap(depth.astype(np.float32), hits.normal.astype(np.float32), hits.mask.astype(np.float32)))
    return DepthMaps([view.camera for view in views], maps, [each.score for each in maps])


@pytest.fixture(scope="module")
def depths(erring: list[View], true: list[View]) -> DepthMaps:
    return depths_of(split(erring)[0], split(true)[0])


@pytest.fixture(scope="module")
def adjusted(erring: list[View], depths: DepthMaps) -> AdjustedCameras:
    done: list[float] = []
    found = adjust_cameras(*split(erring), depths, done.append, OPTIONS)
    assert found is not None and done == sorted(done) and done[-1] == 1
    return found


def test_cameras_come_nearer_to_the_truth(true: list[View], erring: list[View], adjusted: AdjustedCameras) -> None:
    for before, after, right in zip(split(erring), (adjusted.train, adjusted.test), split(true), strict=True):
        exact = [view.camera for view in right]
        assert error(after, exact) < 0.4 * error([view.camera for view in before], exact)


def test_test_cameras_fit_the_training_cameras(true: list[View], adjusted: AdjustedCameras) -> None:
    exact = [view.camera for each in split(true) for view in each]
    assert error([*adjusted.train, *adjusted.test], exact) < 0.25


def test_the_frame_stays(erring: list[View], adjusted: AdjustedCameras) -> None:
    before = np.array([view.camera.center for each in split(erring) for view in each])
    after = np.array([camera.center for camera in (*adjusted.train, *adjusted.test)])
    assert np.abs(after.mean(axis=0) - before.mean(axis=0)).max() < 1e-3
    spread = [np.linalg.norm(each - each.mean(axis=0), axis=1).mean() for each in (before, after)]
    assert spread[1] == pytest.approx(spread[0], rel=1e-3)
    for camera in adjusted.train:
        assert np.allclose(camera.cam_from_world[:3, :3] @ camera.cam_from_world[:3, :3].T, np.eye(3), atol=1e-12)


def test_exact_cameras_stay(true: list[View]) -> None:
    train, test = split(true)
    assert adjust_cameras(train, test, depths_of(train, train), options=OPTIONS) is None


def test_other_exposures_change_nothing(erring: list[View], depths: DepthMaps, adjusted: AdjustedCameras) -> None:
    def darker(views: list[View]) -> list[View]:
        light = [(view.image / 255.0) ** 2.2 * (0.6 + 0.4 * (index % 2)) for index, view in enumerate(views)]
        images = [np.round(255 * each ** (1 / 2.2)).astype(np.uint8) for each in light]
        return [replace(view, image=image) for view, image in zip(views, images, strict=True)]

    train, test = split(erring)
    other = adjust_cameras(darker(train), darker(test), depths, options=OPTIONS)
    assert other is not None
    for one, two in zip(adjusted.train, other.train, strict=True):
        assert np.abs(one.cam_from_world - two.cam_from_world).max() < 0.25 * SHIFT


def test_invalid_pixels_are_not_used(erring: list[View], depths: DepthMaps, true: list[View]) -> None:
    draw = np.random.default_rng(3)

    def spoilt(view: View) -> View:
        valid = np.ones(view.image.shape[:2], bool)
        valid[:, : view.camera.width // 2] = False
        noise = draw.integers(0, 256, view.image.shape).astype(np.uint8)
        return replace(view, image=np.where(valid[..., None], view.image, noise), valid_mask=valid)

    train, test = split(erring)
    found = adjust_cameras([spoilt(train[0]), *train[1:]], test, depths, options=OPTIONS)
    assert found is not None
    exact = [view.camera for view in split(true)[0]]
    assert error(found.train, exact) < 0.5 * error([view.camera for view in train], exact)


def test_views_without_depth_maps_are_adjusted_too(
    true: list[View], erring: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(items: Sequence[Any]) -> list[Any]:
        return list(items[::2])

    monkeypatch.setattr(bundle_adjustment, "some_of", half)
    (train, test), (right, _) = split(erring), split(true)
    found = adjust_cameras(train, test, depths_of(half(train), half(right)), options=OPTIONS)
    assert found is not None
    exact = [view.camera for view in right]
    before = [view.camera for view in train]
    for some in (slice(0, None, 2), slice(1, None, 2)):
        assert error(found.train[some], exact[some]) < 0.7 * error(before[some], exact[some])


def test_few_anchors_change_nothing(erring: list[View], depths: DepthMaps) -> None:
    assert adjust_cameras(*split(erring), depths, options=replace(OPTIONS, min_anchors=10**6)) is None
