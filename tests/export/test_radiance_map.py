"""environment.exr, read back: lamps lie where OpenEXR's convention has them."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from mgsr.export.gltf import UpAxis
from mgsr.export.radiance_map import write_radiance_map

HEIGHT = 40


def lamp(direction: np.ndarray) -> np.ndarray:
    """Return a map [H,2H,3] with a red lamp in a direction of the capture's frame."""
    polar = (np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi
    azimuth = (np.arange(2 * HEIGHT) + 0.5) / HEIGHT * np.pi
    down, around = np.meshgrid(polar, azimuth, indexing="ij")
    cells = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], -1)
    lit = cells @ direction > np.cos(np.radians(8))
    return np.where(lit[..., None], [20.0, 1, 1], [0.5, 0.5, 0.5]).astype(np.float32)


@pytest.mark.parametrize(
    ("up", "towards", "column", "row"),
    [
        (UpAxis.Y, (0, 1, 0), None, 0.0),
        (UpAxis.Y, (0, 0, 1), 0.5, 0.5),
        (UpAxis.Y, (1, 0, 0), 0.25, 0.5),
        (UpAxis.Z, (0, 0, 1), None, 0.0),
        (UpAxis.Z, (0, -1, 0), 0.5, 0.5),  # a z-up frame's -y is the model's +z
    ],
)
def test_a_lamp_lies_where_openexr_has_it(
    tmp_path: Path, up: UpAxis, towards: tuple[int, int, int], column: float | None, row: float
) -> None:
    write_radiance_map(tmp_path / "environment.exr", lamp(np.array(towards, float)), up)
    image = OpenImageIO.ImageBuf(str(tmp_path / "environment.exr"))
    pixels = np.asarray(image.get_pixels(OpenImageIO.FLOAT))
    assert pixels.shape == (128, 256, 3) and image.spec().get_string_attribute("textureformat") == "LatLong Environment"
    weights = pixels[..., 0] - 0.5
    assert pixels[..., 0].max() == pytest.approx(20, rel=0.01), "brighter than white"
    rows, columns = np.mgrid[:128, :256] + 0.5
    bright = weights > 10
    assert (rows[bright] / 128).mean() == pytest.approx(row, abs=0.05)
    if column is not None:
        assert (columns[bright] / 256).mean() == pytest.approx(column, abs=0.01)


def test_the_same_light_gives_the_same_bytes_at_any_time(tmp_path: Path) -> None:
    for name in ("first.exr", "second.exr"):
        write_radiance_map(tmp_path / name, lamp(np.array([0.0, 0, 1])), UpAxis.Y)
        time.sleep(1.1)  # files tell the time in seconds
    assert (tmp_path / "first.exr").read_bytes() == (tmp_path / "second.exr").read_bytes()
