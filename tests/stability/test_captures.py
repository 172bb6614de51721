"""Small trainings of captures that are hard to learn from: they end with finite numbers and without a bad step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import torch

from mgsr.config.expert import NormalisationOptions
from mgsr.data.camera import Camera
from mgsr.data.images import read_image
from mgsr.data.normalise import normalisation
from mgsr.data.scene import Scene, Similarity, View
from mgsr.data.silhouettes import view_silhouettes
from mgsr.training.progress import TrainResult
from mgsr.training.run import Training
from tests.training.ball import DISTANCE, RADIUS, ball_points, ball_scene
from tests.training.short_training import short, tensors

QUICK = ("warmup.surfel_iterations=8", "warmup.gaussian_iterations=8", "mutual.iterations=4", "curve_every=1000")


def trained(scene: Scene, *overrides: str) -> TrainResult:
    """Train a scene, and check that it is finite throughout, and that nothing had to be undone."""
    result = Training(scene, ball_points(60), short("mgsr", *QUICK, *overrides)).run()
    assert result.incidents == []
    assert all(torch.isfinite(tensor).all() for tensor in tensors(result).values())
    return result


def with_images(scene: Scene, value: int, alpha: int | None) -> Scene:
    """Make every photograph one grey, with a mask of one value or, for None, its own."""

    def flat(view: View) -> View:
        mask = view.alpha if alpha is None or view.alpha is None else np.full_like(view.alpha, alpha)
        return replace(view, image=np.full_like(view.image, value), alpha=mask)

    return replace(scene, train=[flat(view) for view in scene.train])


@pytest.mark.parametrize("masked", [True, False], ids=["masked", "plain"])
@pytest.mark.parametrize("value", [0, 128, 255], ids=["black", "grey", "saturated"])
def test_constant_photographs(value: int, masked: bool) -> None:
    trained(with_images(ball_scene(20, train=4, test=1, masked=masked), value, None))


@pytest.mark.parametrize("alpha", [0, 255], ids=["nothing", "everything"])
def test_masks_that_cover(alpha: int) -> None:
    trained(with_images(ball_scene(20, train=4, test=1), 90, alpha))


def test_a_view_that_sees_nothing() -> None:
    scene = ball_scene(20, train=4, test=1)
    pose = scene.train[1].camera.cam_from_world.copy()
    pose[:3] = np.diag([-1.0, 1, -1]) @ pose[:3]  # turned about
    scene.train[1] = replace(scene.train[1], camera=replace(scene.train[1].camera, cam_from_world=pose))
    trained(scene)


def test_a_camera_in_the_middle_of_the_scene() -> None:
    """Check a camera whose distance from the centre, in which depths are compared, is zero."""
    scene = ball_scene(20, train=4, test=1)
    pose = scene.train[1].camera.cam_from_world.copy()
    pose[:3, 3] = 0
    scene.train[1] = replace(scene.train[1], camera=replace(scene.train[1].camera, cam_from_world=pose))
    trained(scene)


def test_three_views() -> None:
    trained(ball_scene(20, train=3, test=1))


def test_a_thousand_views() -> None:
    """Check more views than there are iterations: no epoch ever ends."""
    trained(ball_scene(8, train=1000, test=1), "stop_rule=epoch")


def test_duplicated_views() -> None:
    scene = ball_scene(20, train=3, test=1)
    copies = [replace(view, name=f"{view.name}_{i}") for i in range(4) for view in scene.train]
    trained(replace(scene, train=copies))


def test_opposite_cameras() -> None:
    """Check two cameras that look at each other through the ball."""
    trained(opposite_scene())


def test_opposite_cameras_have_a_centre_between_them() -> None:
    """Check that opposite cameras have a centre between them.

    Their axes are one line, so nothing on it is nearest to both; masks and box still say where the ball is.
    """
    user_from_scene = frame(opposite_scene().train)
    assert np.isfinite(user_from_scene.offset).all() and 0.5 * RADIUS < user_from_scene.scale < 2 * DISTANCE
    assert np.linalg.norm(user_from_scene.offset) < RADIUS


def frame(views: list[View]) -> Similarity:
    return normalisation(views, None, view_silhouettes(views, NormalisationOptions().contour_side))


def opposite_scene() -> Scene:
    scene = ball_scene(20, train=4, test=1)
    view = scene.train[0]
    pose = view.camera.cam_from_world.copy()
    pose[:3] = np.diag([-1.0, 1, -1]) @ pose[:3]
    pose[:3, 3] = [0, 0, DISTANCE]
    behind = replace(view, name="behind", camera=replace(view.camera, cam_from_world=pose))
    return replace(scene, train=[view, behind])


@pytest.mark.parametrize("masked", [True, False], ids=["masked", "plain"])
@pytest.mark.parametrize(("unit", "shift"), [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e4), (1e3, 1e7)])
def test_captures_in_other_units_and_places_are_one_scene(masked: bool, unit: float, shift: float) -> None:
    """Check that captures in other units and places are one scene.

    Training sees the normalised scene: poses are float64 until then, so nothing is lost.
    """
    views = ball_scene(20, train=6, test=1, masked=masked).train
    moved = [replace(view, camera=moved_camera(view.camera, unit, shift)) for view in views]
    here, there = frame(views), frame(moved)
    for view, other in zip(views, moved, strict=True):
        expected = here.camera_to_scene(view.camera).cam_from_world
        assert np.allclose(there.camera_to_scene(other.camera).cam_from_world, expected, atol=1e-5)


def moved_camera(camera: Camera, unit: float, shift: float) -> Camera:
    pose = camera.cam_from_world.copy()
    pose[:3, 3] = unit * pose[:3, 3] - pose[:3, :3] @ np.full(3, shift)
    return replace(camera, cam_from_world=pose)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_pixel_in_a_float_image(tmp_path: Path, bad: float) -> None:
    """Check that NaN and minus infinity become black, infinity white, and that the other pixels stay as they are."""
    pixels = np.random.default_rng(0).uniform(0, 1, (6, 7, 3)).astype(np.float32)
    clean, broken = tmp_path / "clean.exr", tmp_path / "broken.exr"
    write_exr(clean, pixels)
    pixels[2, 3] = bad
    write_exr(broken, pixels)
    (expected, _), (got, _) = read_image(clean, "test"), read_image(broken, "test")
    assert (got[2, 3] == (255 if bad > 0 else 0)).all()
    got[2, 3] = expected[2, 3]
    assert np.array_equal(got, expected)


def write_exr(path: Path, pixels: np.ndarray) -> None:
    height, width, channels = pixels.shape
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width, height, channels, "float"))
    buffer.set_pixels(OpenImageIO.ROI(), pixels)
    assert buffer.write(str(path))
