"""Images of which only a part is known, held to the known part cut out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mgsr.config import DataConfig
from mgsr.data.camera import Camera
from mgsr.data.images import reduce_area
from mgsr.data.loading import reduced_view
from mgsr.data.readers import load_scene
from mgsr.data.scene import View
from mgsr.data.silhouettes import signed_distance, view_silhouettes
from mgsr.data.valid_mask import filled, largest_rectangle, valid_inside, valid_mean, whole_part
from mgsr.export.scenes import write_scene
from mgsr.geometry.contours import find_contour
from tests.data.fisheye import FOCAL, SIDE, ball_color, write_fisheye

RNG = np.random.default_rng(3)
WINDOW = (slice(4, 40), slice(6, 50))
CAMERA = Camera(np.array([[50.0, 0, 30], [0, 50, 24], [0, 0, 1]]), np.eye(4), 60, 48)


def window() -> np.ndarray:
    known = np.zeros((48, 60), bool)
    known[WINDOW] = True
    return known


def disc() -> np.ndarray:
    """Return alpha 0..1 of a disc that the window cuts off."""
    y, x = np.mgrid[:48, :60] + 0.5
    shade: np.ndarray = np.clip(12.5 - np.hypot(x - 44, y - 22), 0, 1)
    return shade


def view() -> View:
    """Return a view whose colours and alpha are noise outside the window."""
    image = RNG.integers(0, 256, (48, 60, 3)).astype(np.uint8)
    alpha = np.where(window(), disc() * 255, RNG.integers(0, 256, (48, 60))).astype(np.uint8)
    return View("a", CAMERA, image, alpha, window())


def test_distances_know_of_no_outline_where_the_known_part_ends() -> None:
    alpha = np.where(window(), disc(), RNG.integers(0, 2, (48, 60)))
    np.testing.assert_array_equal(signed_distance(alpha, window())[WINDOW], signed_distance(disc()[WINDOW]))


@pytest.mark.parametrize("inside", [0.0, 1.0])
def test_distances_without_any_known_outline(inside: float) -> None:
    alpha = np.where(window(), inside, 1 - inside)
    assert (signed_distance(alpha, window()) == (1e3 if inside else -1e3)).all()


def test_outlines_end_where_the_known_part_ends() -> None:
    (silhouette,) = view_silhouettes([view()], 100)
    points = find_contour(silhouette).points
    assert len(points) > 20
    assert ((points > [7, 5]) & (points < [49, 39])).all()
    np.testing.assert_allclose(np.hypot(*(points - [44, 22]).T), 12, atol=0.15)


def test_means_are_those_of_the_known_pixels() -> None:
    """Check against the means of the window alone, which holds whole blocks of 2 x 2 pixels."""
    given = view()
    small = reduced_view(given, 0.5)
    assert given.alpha is not None
    cut = View("a", Camera(CAMERA.K, np.eye(4), 44, 36), given.image[WINDOW], given.alpha[WINDOW])
    expected = reduced_view(cut, 0.5)
    np.testing.assert_array_equal(small.valid_mask, window()[::2, ::2])
    np.testing.assert_allclose(small.image[2:20, 3:25], expected.image, atol=1)
    assert small.alpha is not None and expected.alpha is not None
    np.testing.assert_allclose(small.alpha[2:20, 3:25], expected.alpha, atol=1)
    assert small.valid_mask is not None
    assert not small.image[~small.valid_mask].any() and not small.alpha[~small.valid_mask].any()


def test_pixels_that_are_mostly_unknown_are_unknown() -> None:
    _, known = valid_mean(np.zeros((48, 60, 3), np.float32), window(), lambda pixels: reduce_area(pixels, 20, 16))
    inner = np.zeros((16, 20), bool)
    inner[2:13, 2:16] = True  # the rows 3 to 5 and the columns 48 to 50 are known in part
    np.testing.assert_array_equal(known, inner)


def test_filling_takes_the_nearest_known_pixel() -> None:
    image = RNG.integers(0, 256, (48, 60, 3)).astype(np.uint8)
    rows, columns = np.mgrid[:48, :60]
    np.testing.assert_array_equal(filled(image, window()), image[rows.clip(4, 39), columns.clip(6, 49)])
    assert filled(image, None) is image
    assert not filled(image, np.zeros((48, 60), bool)).any()


def test_what_lies_deep_inside() -> None:
    expected = np.zeros((48, 60), bool)
    expected[6:38, 8:48] = True
    np.testing.assert_array_equal(valid_inside(window(), 2), expected)


def test_the_largest_rectangle_of_a_disc() -> None:
    """Check that a disc's largest rectangle is a square inscribed into the circle, to a pixel or two."""
    y, x = np.mgrid[:200, :200] + 0.5
    known = np.hypot(x - 100, y - 100) < 90
    rows, columns = largest_rectangle(known)
    assert known[rows, columns].all()
    assert (rows.stop - rows.start) * (columns.stop - columns.start) > 0.95 * 2 * 90**2


def test_the_whole_part_keeps_its_rays() -> None:
    part = whole_part(view())
    np.testing.assert_array_equal(part.alpha, (disc() * 255).astype(np.uint8)[WINDOW])
    assert part.valid_mask is None and part.image.shape == (36, 44, 3)
    np.testing.assert_allclose(part.camera.K[:2, 2], CAMERA.K[:2, 2] - [6, 4])


def test_a_fisheye_shows_all_that_it_saw(tmp_path: Path) -> None:
    """Check that each known pixel has the ball's colour where its own ray meets it, and that the corners are there."""
    scene = load_scene(write_fisheye(tmp_path), DataConfig())
    for view in scene.train:
        camera = scene.user_from_scene.camera_to_user(view.camera)
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([(x - camera.K[0, 2]) / FOCAL, (y - camera.K[1, 2]) / FOCAL, np.ones_like(x)], axis=-1)
        angle = np.arctan(np.hypot(rays[..., 0], rays[..., 1]))
        places = rays[..., :2] * (angle / np.maximum(np.tan(angle), 1e-9))[..., None] * FOCAL + SIDE / 2
        sure = (np.abs(places) > 0.01).all(-1) & (np.abs(places - SIDE) > 0.01).all(-1)
        shown = ((places > 0) & (places < SIDE)).all(-1) & (angle < np.radians(60))
        assert view.valid_mask is not None
        np.testing.assert_array_equal(view.valid_mask[sure], shown[sure])
        directions = rays @ camera.cam_from_world[:3, :3]
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        along = -(directions @ camera.center)
        left = 0.8**2 - (camera.center @ camera.center - along**2)
        points = camera.center + directions * (along - np.sqrt(np.maximum(left, 0)))[..., None]
        solid = view.valid_mask & (left > 0.15) & (view.alpha == 255)
        assert solid.sum() > 200
        assert np.abs(view.image[solid] / 255 - ball_color(points[solid])).mean() < 0.02
        assert view.alpha is not None
        assert (view.alpha[view.valid_mask & (left < -0.3)] == 0).all()
    assert len({id(view.valid_mask) for view in scene.train}) == 1  # one camera's photographs share it


def test_written_scenes_have_no_unknown_pixels(tmp_path: Path) -> None:
    scene = load_scene(write_fisheye(tmp_path / "in"), DataConfig())
    (tmp_path / "out").mkdir()
    write_scene(tmp_path / "out", scene)
    read = load_scene(tmp_path / "out", DataConfig(test_every=100))
    assert read.train[0].valid_mask is None and read.masked
    by_name = {view.name.removeprefix("train_"): view for view in read.train}
    for given in scene.train:
        part, got = whole_part(given), by_name[given.name]
        np.testing.assert_array_equal(got.image, part.image)
        np.testing.assert_allclose(got.camera.K, part.camera.K)
