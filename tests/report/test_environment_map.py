"""Pictures of the environment map: a lamp must appear where it is."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.report.environment_map import HEIGHT, environment_map_pictures
from mgsr.report.pictures import Picture


def lit_from(direction: np.ndarray, part: int) -> EnvironmentMap:
    """Return the light of one small lamp.

    Its texel is the one whose direction is nearest, searched in the plain definition of the map.
    """
    side = 32
    rows, columns = (np.mgrid[:side, :side] + 0.5) / side * 2 - 1
    z = 1 - np.abs(rows) - np.abs(columns)
    x = np.where(z < 0, (1 - np.abs(rows)) * np.sign(columns), columns)
    y = np.where(z < 0, (1 - np.abs(columns)) * np.sign(rows), rows)
    towards = np.stack([x, y, z], axis=-1)
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    maps = np.full((2, 3, side, side), 0.01)
    maps[part][:, (towards @ direction) > 0.97] = 0.9
    return EnvironmentMap.of(maps, np.ones(3))


def the_only(pictures: list[Picture]) -> np.ndarray:
    """Take the one picture: the other map is dark, so it has none."""
    assert len(pictures) == 1
    return pictures[0].pixels


def brightest(pixels: np.ndarray) -> np.ndarray:
    """Return row and column of the brightest pixel, in shares of the picture's height."""
    rows, columns = np.nonzero(pixels[..., :3].min(axis=-1) > 200)
    return np.array([rows.mean() + 0.5, columns.mean() + 0.5]) / HEIGHT


@pytest.mark.parametrize(
    ("direction", "row"), [((0, 0, 1), 0.0), ((0.6, 0.0, 0.8), 0.2), ((0, -1, 0), 0.5), ((0, 0, -1), 1.0)]
)
def test_a_lamp_stands_at_its_height(direction: tuple[float, float, float], row: float) -> None:
    around = the_only(environment_map_pictures(lit_from(np.array(direction), 0), np.array([0, 0, 1.0])))
    assert around.shape == (HEIGHT, 2 * HEIGHT, 3)
    assert abs(brightest(around)[0] - row) < 0.08


def test_lamps_a_quarter_apart_stand_a_quarter_apart() -> None:
    places = []
    for angle in (0.3, 0.3 + np.pi / 2):
        lamp = np.array([np.cos(angle), np.sin(angle), 0.0])
        places.append(brightest(the_only(environment_map_pictures(lit_from(lamp, 0), np.array([0, 0, 1.0]))))[1])
    apart = (places[1] - places[0]) % 2  # the picture is twice as wide as high, and closes
    assert abs(min(apart, 2 - apart) - 0.5) < 0.03


def test_a_flash_beside_the_lens_stands_beside_the_middle() -> None:
    lamp = np.array([0.3, 0.0, np.sqrt(1 - 0.09)])
    camera = the_only(environment_map_pictures(lit_from(lamp, 1), np.array([0, 0, 1.0])))
    assert np.abs(brightest(camera) - [0.5, 0.5 + 0.15]).max() < 0.03
    assert camera[0, 0, 3] == 0 and camera[HEIGHT // 2, HEIGHT // 2, 3] == 255
