"""Sharpened textures, held to a ball whose fine stripes are known at every place."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from mgsr.config.expert import ColorOptions
from mgsr.data.camera import Camera
from mgsr.geometry.raycast import pixel_rays
from mgsr.mesh.colors import PointsInViews, blended_colors
from mgsr.mesh.sharpening import _splatted, sharpened
from mgsr.mesh.views import SurfaceView
from tests.mesh.shapes import as_mesh, ball, cameras_around

RADIUS = 0.7
SIDE = 64  # pixels, of which one is 0.036 wide on the ball
FINE = 4  # rays along a pixel's side
PERIOD = 0.12  # of the stripes: three pixels
TOLERANCE = 3.0


def stripes(places: np.ndarray) -> np.ndarray:
    """Return grey stripes across z at places [...,3]."""
    level = 0.5 + 0.3 * np.sin(2 * np.pi * places[..., 2] / PERIOD)
    return np.repeat(level[..., None], 3, axis=-1)


def grey(places: np.ndarray) -> np.ndarray:
    return np.full(places.shape, 0.4)


def photographed(cameras: Sequence[Camera], color: Callable[[np.ndarray], np.ndarray]) -> list[SurfaceView]:
    """Return views of the ball in which each pixel is the mean of the colours that it shows."""
    caster, views = as_mesh(ball(RADIUS)).caster, []
    for camera in cameras:
        fine = camera.resized(FINE * camera.width, FINE * camera.height)
        places = fine.center + pixel_rays(fine) * caster.cast(fine).depth[..., None]
        blocks = color(places).reshape(camera.height, FINE, camera.width, FINE, 3)
        hits = caster.cast(camera)
        mean = blocks.mean(axis=(1, 3)).astype(np.float32)
        views.append(SurfaceView(camera, hits.depth, hits.normal, hits.mask.astype(np.float32), mean))
    return views


def points_on_ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places spread evenly over the ball, and its unit normals there, each [count,3]."""
    heights = 1 - (2 * np.arange(count) + 1) / count
    angles = np.arange(count) * np.pi * (3 - 5**0.5)
    flat = np.sqrt(1 - heights**2)
    normals = np.stack([flat * np.cos(angles), flat * np.sin(angles), heights], axis=1)
    return RADIUS * normals, normals


def seen_by(views: Sequence[SurfaceView], count: int) -> PointsInViews:
    """Return points spread evenly over the ball, in the views."""
    return PointsInViews(*points_on_ball(count), views, 0.5, TOLERANCE, ColorOptions().grazing)


def colors_of(
    count: int, color: Callable[[np.ndarray], np.ndarray], options: ColorOptions = ColorOptions()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the places, the blended and the sharpened colours of `count` texels, each [count,3]."""
    points = seen_by(photographed(cameras_around(24, side=SIDE), color), count)
    blended, seen = blended_colors(points)
    assert seen.all()
    return points_on_ball(count)[0], blended, sharpened(blended, points, options=options)


def test_stripes_regain_their_contrast() -> None:
    points, blended, sharp = colors_of(8000, stripes)  # texels of the pixels' size
    truth = stripes(points)
    contrast = [float(((each - 0.5) * (truth - 0.5)).sum() / ((truth - 0.5) ** 2).sum()) for each in (blended, sharp)]
    errors = [float(np.abs(each - truth).mean()) for each in (blended, sharp)]
    # Texels may exceed the true contrast, because a renderer's interpolation between them takes some away.
    assert contrast[0] < 0.85 and 0.95 < contrast[1] < 1.1
    assert errors[1] < 0.5 * errors[0]


def test_an_even_colour_stays() -> None:
    _, blended, sharp = colors_of(8000, grey)
    np.testing.assert_allclose(sharp, 0.4, atol=1e-3)
    np.testing.assert_allclose(blended, 0.4, atol=1e-3)


def test_textures_coarser_than_the_views_stay() -> None:
    def change(options: ColorOptions) -> float:
        _, blended, sharp = colors_of(500, stripes, options)
        return float(np.abs(sharp - blended).mean())

    assert change(ColorOptions()) < 0.1 * change(ColorOptions(min_texels=0.0))


def test_few_views_sharpen_less() -> None:
    def change(views: int) -> float:
        """Return the mean change of the texels that a number of views show."""
        points = seen_by(photographed(cameras_around(24, side=SIDE)[12 : 12 + views], stripes), 8000)
        blended, seen = blended_colors(points)
        sharp = sharpened(blended, points)
        np.testing.assert_array_equal(sharp[~seen], blended[~seen])
        return float(np.abs(sharp - blended)[seen].mean())

    assert change(1) < 0.7 * change(12)


def test_without_rounds_nothing_is_sharpened() -> None:
    _, blended, sharp = colors_of(8000, stripes, ColorOptions(back_projections=0))
    np.testing.assert_array_equal(sharp, blended)


@pytest.mark.parametrize("count", [0, 1, 50])
def test_points_are_shared_between_the_pixels_around_them(count: int) -> None:
    """Compare with a sum over tent functions of width 2 pixels, in float64."""
    random = np.random.default_rng(3)
    height, width = 5, 7
    pixels = random.uniform(0.5, [width - 0.5, height - 0.5], (count, 2)).astype(np.float32)
    colors = random.random((count, 3)).astype(np.float32)
    means, texels = _splatted(colors, pixels, (height, width))
    rows, columns = np.mgrid[:height, :width] + 0.5
    across = np.maximum(1 - np.abs(columns[..., None] - pixels[:, 0].astype(float)), 0)
    down = np.maximum(1 - np.abs(rows[..., None] - pixels[:, 1].astype(float)), 0)
    shares = across * down
    np.testing.assert_allclose(texels, shares.sum(-1), atol=1e-5)
    expected = np.einsum("hwp,pc->hwc", shares, colors.astype(float))
    np.testing.assert_allclose(means * texels[..., None], expected, atol=1e-5)
