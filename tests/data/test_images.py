"""Decoding held to Pillow, area reduction to sums by hand."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from mgsr.data.images import composite_on_white, read_image, read_mask, reduce_area

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA", "P", "1"])
def test_png_modes_agree_with_pillow(tmp_path, mode):
    pixels = RNG.integers(0, 256, (11, 17, 4), dtype=np.uint8)
    image = Image.fromarray(pixels if "A" in mode else pixels[..., :3].copy()).convert(mode)
    image.save(tmp_path / "a.png")
    colors, alpha = read_image(tmp_path / "a.png", "test")
    np.testing.assert_array_equal(colors, np.asarray(image.convert("RGB")))
    assert (alpha is not None) == (mode in ("LA", "RGBA"))
    if alpha is not None:
        np.testing.assert_array_equal(alpha, pixels[..., 3])


def test_jpeg_agrees_with_pillow(tmp_path):
    Image.fromarray(RNG.integers(0, 256, (16, 24, 3), dtype=np.uint8)).resize((48, 32)).save(tmp_path / "a.jpg")
    colors, alpha = read_image(tmp_path / "a.jpg", "test")
    with Image.open(tmp_path / "a.jpg") as image:
        # Two JPEG decoders may round their transforms differently.
        assert np.abs(colors.astype(int) - np.asarray(image)).max() <= 3
    assert alpha is None


def test_sixteen_bits(tmp_path):
    values = np.linspace(0, 65535, 20, dtype=np.uint16).reshape(4, 5)
    Image.fromarray(values).save(tmp_path / "a.png")
    colors, _ = read_image(tmp_path / "a.png", "test")
    np.testing.assert_allclose(colors[..., 0], values / 257, atol=0.51)


def test_linear_exr_becomes_srgb(tmp_path):
    import OpenImageIO

    linear = np.array([[[0.0, 0.18, 1.0], [0.002, 0.5, 7.0]]], dtype=np.float32)
    buffer = OpenImageIO.ImageBuf(linear)
    assert buffer.write(str(tmp_path / "a.exr"))
    colors, _ = read_image(tmp_path / "a.exr", "test")
    # 0.18 is the well-known mid-grey 118; 0.5 is 188; above 1 clips.
    np.testing.assert_array_equal(colors, [[[0, 118, 255], [7, 188, 255]]])


def test_mask_in_an_alpha_channel(tmp_path):
    pixels = np.zeros((4, 4, 4), np.uint8)
    pixels[1:3, 1:3, 3] = 255
    Image.fromarray(pixels).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", "test"), pixels[..., 3])


def test_area_reduction_by_whole_factors_is_the_mean():
    image = RNG.random((12, 8, 3)).astype(np.float32)
    expected = image.reshape(4, 3, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(reduce_area(image, 4, 4), expected, rtol=1e-5)


def test_area_reduction_by_fractions():
    """Five pixels to two: each takes two and a half."""
    image = np.arange(5, dtype=np.float32)[None, :, None]
    np.testing.assert_allclose(reduce_area(image, 2, 1)[0, :, 0], [(0 + 1 + 1) / 2.5, (1 + 3 + 4) / 2.5], rtol=1e-6)


def test_white():
    colors = np.full((1, 1, 3), 100, np.uint8)
    assert composite_on_white(colors, np.array([[0]], np.uint8)).max() == 255
    np.testing.assert_array_equal(composite_on_white(colors, np.array([[51]], np.uint8)), np.full((1, 1, 3), 224))
