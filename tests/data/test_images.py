"""Decoding held to Pillow, area reduction to sums by hand."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from PIL import Image, ImageOps

from mgsr.data import images
from mgsr.data.images import composite_on_white, image_size, read_image, read_mask, read_picture, reduce_area, upright
from mgsr.errors import SceneError, in_short

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


@pytest.mark.parametrize("name", ["a.tif", "a.exr"])
def test_float_images_that_say_they_are_srgb_are_left_as_they_are(tmp_path, name):
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(2, 1, 3, "float")
    spec.attribute("oiio:ColorSpace", "srgb_rec709_scene")
    output = OpenImageIO.ImageOutput.create(str(tmp_path / name))
    output.open(str(tmp_path / name), spec)
    output.write_image(np.full((1, 2, 3), 0.2, np.float32))
    output.close()
    colors, _ = read_image(tmp_path / name, "test")
    # 0.2 of 255, or that as linear light: 124.
    assert (colors == (51 if says_srgb(tmp_path / name) else 124)).all()


def says_srgb(path) -> bool:
    """Not every file type has a place for it."""
    import OpenImageIO

    return str(OpenImageIO.ImageInput.open(str(path)).spec().getattribute("oiio:ColorSpace")).startswith("srgb")


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_cmyk_agrees_with_pillow(tmp_path, suffix):
    image = Image.fromarray(RNG.integers(0, 256, (16, 24, 3), dtype=np.uint8)).resize((48, 32)).convert("CMYK")
    image.save(tmp_path / f"a{suffix}")
    colors, alpha = read_image(tmp_path / f"a{suffix}", "test")
    with Image.open(tmp_path / f"a{suffix}") as opened:
        assert np.abs(colors.astype(int) - np.asarray(opened.convert("RGB"))).max() <= 3
    assert alpha is None


@pytest.mark.parametrize("orientation", range(1, 9))
def test_upright_agrees_with_pillow(tmp_path, orientation):
    pixels = RNG.integers(0, 256, (6, 9, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    picture = read_picture(tmp_path / "a.png", "test")
    np.testing.assert_array_equal(picture.colors, pixels)
    with Image.open(tmp_path / "a.png") as opened:
        np.testing.assert_array_equal(upright(picture.colors, picture.orientation), ImageOps.exif_transpose(opened))


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L"])
def test_heic_agrees_with_pillow(tmp_path, mode):
    pillow_heif = pytest.importorskip("pillow_heif")
    image = Image.fromarray(RNG.integers(0, 256, (4, 6, 4), dtype=np.uint8)).resize((96, 64)).convert(mode)
    pillow_heif.from_pillow(image).save(tmp_path / "a.heic", quality=90)
    colors, alpha = read_image(tmp_path / "a.heic", "test")
    assert image_size(tmp_path / "a.heic", "test") == (96, 64) and colors.shape == (64, 96, 3)
    # What lossy coding does to smooth colours.
    assert np.abs(colors.astype(int) - np.asarray(image.convert("RGB"))).mean() < 4
    assert (alpha is not None) == (mode == "RGBA")


def test_truncated_jpeg(tmp_path):
    Image.fromarray(RNG.integers(0, 256, (90, 120, 3), dtype=np.uint8)).save(tmp_path / "a.jpg")
    data = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(data[: len(data) // 2])
    with pytest.raises(SceneError, match=r"a\.jpg: damaged image: .*Premature end.*asked for by view 3.*copy it again"):
        read_image(tmp_path / "a.jpg", "view 3")


@pytest.mark.parametrize(("cut", "message"), [(20, "not an image that can be read"), (400, "damaged image")])
def test_truncated_heic(tmp_path, cut, message):
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.from_pillow(Image.new("RGB", (96, 64))).save(tmp_path / "a.heic")
    (tmp_path / "a.heic").write_bytes((tmp_path / "a.heic").read_bytes()[:cut])
    with pytest.raises(SceneError, match=rf"(?s)a\.heic: {message}.*asked for by view 3.*; copy it again"):
        read_image(tmp_path / "a.heic", "view 3")


def test_a_heic_whose_header_lies_about_its_colors(tmp_path):
    """Found by fuzzing: it opens, and pillow-heif raises SyntaxError when it decodes."""
    pillow_heif = pytest.importorskip("pillow_heif")
    path = tmp_path / "a.heic"
    pillow_heif.from_pillow(Image.new("RGB", (96, 64))).save(path)
    whole = bytearray(path.read_bytes())
    whole[whole.index(b"hvcC") + 20] &= 0xFC  # chroma_format_idc of ISO/IEC 14496-15: monochrome
    path.write_bytes(whole)
    assert image_size(path, "view 3") == (96, 64)
    with pytest.raises(SceneError, match=r"a\.heic: damaged image: .*asked for by view 3.*; copy it again"):
        read_image(path, "view 3")


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.exr", "a.heic"])
def test_wrong_magic(tmp_path, name):
    (tmp_path / name).write_bytes(b"GIF89 no, not really an image at all")
    with pytest.raises(SceneError, match=rf"{name}: not an image that can be read: .*asked for by view 3"):
        read_image(tmp_path / name, "view 3")


def test_images_too_large_for_any_machine_are_refused_by_their_header(tmp_path):
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 2, 0, 0, 0)
    parts = [
        b"\x89PNG\r\n\x1a\n",
        chunk(b"IHDR", header),
        chunk(b"IDAT", zlib.compress(b"\0" * 99)),
        chunk(b"IEND", b""),
    ]
    (tmp_path / "a.png").write_bytes(b"".join(parts))
    with pytest.raises(SceneError, match=r"a\.png: .*image size 28610.* MB exceeds.*asked for by view 3"):
        read_image(tmp_path / "a.png", "view 3")


def test_large_images_below_the_limit_are_taken(tmp_path, monkeypatch):
    Image.new("RGB", (40, 25)).save(tmp_path / "a.png")
    monkeypatch.setattr(images, "MAX_PIXELS", 1000)
    assert image_size(tmp_path / "a.png", "test") == (40, 25)
    monkeypatch.setattr(images, "MAX_PIXELS", 999)
    with pytest.raises(SceneError, match="40x25 pixels; at most 999 in one image are taken: reduce it"):
        image_size(tmp_path / "a.png", "test")


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


def test_a_heic_that_holds_no_image_is_refused(tmp_path, monkeypatch):
    """Found by fuzzing: pillow-heif opens such files, and fails on their first image."""
    import pillow_heif

    path = tmp_path / "a.heic"
    path.write_bytes(b"damaged")
    monkeypatch.setattr(pillow_heif, "open_heif", lambda *_, **__: [][0])
    with pytest.raises(SceneError, match="not an image that can be read: list index"):
        read_picture(path, "test")


@pytest.mark.parametrize("reason", ["line after line\n" * 5000, "one line " * 5000])
def test_what_libraries_say_is_cut_short(reason):
    """Found by fuzzing: a damaged TIFF gave thousands of lines, a damaged zip the bytes of its first file."""
    assert len(in_short(reason)) < 210
    assert "\n" not in in_short(reason)
