"""Decoding held to Pillow, area reduction to sums by hand."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from mgsr.data import images
from mgsr.data.images import composite_on_white, image_size, read_image, read_mask, read_picture, reduce_area, upright
from mgsr.errors import SceneError, in_short
from tests.optional import present

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA", "P", "1"])
def test_png_modes_agree_with_pillow(tmp_path: Path, mode: str) -> None:
    pixels = RNG.integers(0, 256, (11, 17, 4), dtype=np.uint8)
    image = Image.fromarray(pixels if "A" in mode else pixels[..., :3].copy()).convert(mode)
    image.save(tmp_path / "a.png")
    colors, alpha = read_image(tmp_path / "a.png", "test")
    np.testing.assert_array_equal(colors, np.asarray(image.convert("RGB")))
    assert (alpha is not None) == (mode in ("LA", "RGBA"))
    if alpha is not None:
        np.testing.assert_array_equal(alpha, pixels[..., 3])


def test_jpeg_agrees_with_pillow(tmp_path: Path) -> None:
    Image.fromarray(RNG.integers(0, 256, (16, 24, 3), dtype=np.uint8)).resize((48, 32)).save(tmp_path / "a.jpg")
    colors, alpha = read_image(tmp_path / "a.jpg", "test")
    with Image.open(tmp_path / "a.jpg") as image:
        # Two JPEG decoders may round their transforms differently.
        assert np.abs(colors.astype(int) - np.asarray(image)).max() <= 3
    assert alpha is None


def test_sixteen_bits(tmp_path: Path) -> None:
    values = np.linspace(0, 65535, 20, dtype=np.uint16).reshape(4, 5)
    Image.fromarray(values).save(tmp_path / "a.png")
    colors, _ = read_image(tmp_path / "a.png", "test")
    np.testing.assert_allclose(colors[..., 0], values / 257, atol=0.51)


def test_linear_exr_becomes_srgb(tmp_path: Path) -> None:
    import OpenImageIO

    linear = np.array([[[0.0, 0.18, 1.0], [0.002, 0.5, 7.0]]], dtype=np.float32)
    buffer = OpenImageIO.ImageBuf(linear)
    assert buffer.write(str(tmp_path / "a.exr"))
    colors, _ = read_image(tmp_path / "a.exr", "test")
    # 0.18 is the well-known mid-grey 118; 0.5 is 188; above 1 clips.
    np.testing.assert_array_equal(colors, [[[0, 118, 255], [7, 188, 255]]])


@pytest.mark.parametrize("name", ["a.tif", "a.exr"])
def test_float_images_that_say_they_are_srgb_are_left_as_they_are(tmp_path: Path, name: str) -> None:
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(2, 1, 3, "float")
    spec.attribute("oiio:ColorSpace", "srgb_rec709_scene")
    output = OpenImageIO.ImageOutput.create(str(tmp_path / name))
    assert output is not None
    output.open(str(tmp_path / name), spec)
    output.write_image(np.full((1, 2, 3), 0.2, np.float32))
    output.close()
    colors, _ = read_image(tmp_path / name, "test")
    # 0.2 of 255, or that as linear light: 124.
    assert (colors == (51 if says_srgb(tmp_path / name) else 124)).all()


def write_exr(
    path: Path,
    channels: dict[str, float],
    window: tuple[int, int, int, int] = (0, 0, 4, 3),
    display: tuple[int, int, int, int] | None = None,
) -> Path:
    """Write an EXR of flat channels. window, display: x, y, width and height, by default the same."""
    import OpenImageIO

    _, _, width, height = window
    spec = OpenImageIO.ImageSpec(width, height, len(channels), "float")
    spec.channelnames = tuple(channels)
    spec.x, spec.y, spec.width, spec.height = window
    spec.full_x, spec.full_y, spec.full_width, spec.full_height = display or window
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output is not None
    assert output.open(str(path), spec), output.geterror()
    output.write_image(np.broadcast_to(np.array(list(channels.values()), np.float32), (height, width, len(channels))))
    output.close()
    return path


def as_read(path: Path) -> tuple[list[int], int | None]:
    """Return a flat image's colour and alpha."""
    colors, alpha = read_image(path, "view 3")
    assert (colors == colors[0, 0]).all() and (alpha is None or (alpha == alpha[0, 0]).all())
    return colors[0, 0].tolist(), None if alpha is None else int(alpha[0, 0])


# Linear light of 0.18 and 0.5 is 118 and 188 of 255.
LIGHT, SHOWN = {"R": 0.18, "G": 0.5, "B": 1.0}, [118, 188, 255]


def layer(name: str, **channels: float) -> dict[str, float]:
    return {f"{name}.{channel}": value for channel, value in channels.items()}


@pytest.mark.parametrize(
    ("channels", "colors", "alpha"),
    [
        ({"R": 0.09, "G": 0.25, "B": 0.5, "A": 0.5}, SHOWN, 128),
        ({"R": 0.09, "G": 0.25, "B": 0.5, "A": 0.0}, [85, 137, 188], 0),
        ({"Y": 0.25, "A": 0.5}, [188] * 3, 128),
        ({"Y": 0.5}, [188] * 3, None),
        ({"matte": 0.5}, [188] * 3, None),
        (LIGHT | {"Z": 3.0}, SHOWN, None),
        (LIGHT | {"A": 1.0, "Z": 3.0}, SHOWN, 255),
        (layer("Depth", Z=9.0) | layer("main", **LIGHT, A=1.0), SHOWN, 255),
        (layer("Diffuse", R=0.1, G=0.1, B=0.1) | layer("View.Combined", **LIGHT, A=1.0), SHOWN, 255),
        (layer("Diffuse", R=0.1, G=0.1, B=0.1, A=0.3) | LIGHT, SHOWN, None),
        (layer("Normal", X=0.0, Y=0.0, Z=1.0) | {"Y": 0.5}, [188] * 3, None),
    ],
)
def test_channels_of_an_exr_go_by_their_names(
    tmp_path: Path, channels: dict[str, float], colors: list[int], alpha: int | None
) -> None:
    """Check the channels, whose colours are premultiplied in an EXR: 0.09 at alpha 0.5 is 0.18.

    Source: OpenEXR's technical introduction.
    """
    assert as_read(write_exr(tmp_path / "a.exr", channels)) == (colors, alpha)


@pytest.mark.parametrize(
    "channels",
    [
        layer("Normal", X=0.0, Y=0.0, Z=1.0),
        {"Z": 1.0, "V": 2.0},
        layer("Diffuse", **LIGHT) | layer("Glossy", **LIGHT),
    ],
)
def test_an_exr_of_which_no_layer_is_the_picture(tmp_path: Path, channels: dict[str, float]) -> None:
    write_exr(tmp_path / "a.exr", channels)
    name = next(iter(channels))
    with pytest.raises(
        SceneError, match=rf"a\.exr: expected channels R, G, B.*got .*{name}.*view 3.*only the photograph's layer"
    ):
        read_image(tmp_path / "a.exr", "view 3")


def test_an_exr_whose_second_part_is_the_picture(tmp_path: Path) -> None:
    import OpenImageIO

    path, specs = str(tmp_path / "a.exr"), []
    for names in (("V", "Z"), ("R", "G", "B")):
        specs.append(OpenImageIO.ImageSpec(4, 3, len(names), "float"))
        specs[-1].channelnames = names
        specs[-1].attribute("oiio:subimagename", "-".join(names))
    output = OpenImageIO.ImageOutput.create(path)
    assert output is not None
    assert output.open(path, tuple(specs))
    output.write_image(np.full((3, 4, 2), 9, np.float32))
    assert output.open(path, specs[1], "AppendSubimage")
    output.write_image(np.broadcast_to(np.array([0.18, 0.5, 1], np.float32), (3, 4, 3)))
    output.close()
    assert as_read(tmp_path / "a.exr") == (SHOWN, None)


def test_an_exr_of_which_the_error_is_no_text(tmp_path: Path) -> None:
    """Check an error that is no text, as OpenImageIO puts bytes of the file into it (found by fuzzing)."""
    path = write_exr(tmp_path / "a.exr", LIGHT)
    path.write_bytes(path.read_bytes().replace(b"chlist", b"ch\xffist"))
    with pytest.raises(
        SceneError, match=r"a\.exr: this file is not a readable image: .*ch\ufffdist.*view 3.*copy it again"
    ):
        read_image(path, "view 3")


@pytest.mark.parametrize(
    ("window", "display", "rows", "columns"),
    [
        ((2, 1, 4, 3), (0, 0, 10, 8), range(1, 4), range(2, 6)),  # a render cropped to what is not empty
        ((102, 101, 4, 3), (100, 100, 10, 8), range(1, 4), range(2, 6)),
        ((-2, -1, 14, 12), (0, 0, 10, 8), range(8), range(10)),  # overscan
        ((-2, 5, 4, 9), (0, 0, 10, 8), range(5, 8), range(2)),
        ((20, 1, 4, 3), (0, 0, 10, 8), range(0), range(0)),
        ((-20, 1, 4, 3), (0, 0, 10, 8), range(0), range(0)),
    ],
)
def test_the_display_window_of_an_exr_is_read(
    tmp_path: Path, window: tuple[int, int, int, int], display: tuple[int, int, int, int], rows: range, columns: range
) -> None:
    path = write_exr(tmp_path / "a.exr", LIGHT | {"A": 1.0}, window, display)
    colors, alpha = read_image(path, "test")
    expected = np.zeros((8, 10), np.uint8)
    expected[rows.start : rows.stop, columns.start : columns.stop] = 255
    np.testing.assert_array_equal(alpha, expected)
    np.testing.assert_array_equal(colors, (expected[..., None] > 0) * np.array(SHOWN, np.uint8))
    assert image_size(path, "test") == (10, 8)


def test_a_display_window_that_would_fill_the_memory(tmp_path: Path) -> None:
    path = write_exr(tmp_path / "a.exr", LIGHT, display=(0, 0, 1 << 20, 1 << 20))
    for read in (image_size, read_image):
        with pytest.raises(
            SceneError, match=r"a\.exr: 1048576x1048576 pixels exceed the limit of .* in one image; reduce it"
        ):
            read(path, "test")


PIXEL = [100, 60, 20, 128]


@pytest.mark.parametrize(
    ("pixel", "kinds", "colors", "alpha"),
    [
        (PIXEL, ["assocalpha"], [199, 120, 40], 128),  # 100 * 255 / 128, and so on
        (PIXEL, ["unassalpha"], [100, 60, 20], 128),
        (PIXEL, ["unspecified"], [100, 60, 20], None),  # near infrared, say
        ([100, 60, 20, 7, 128], ["unspecified", "assocalpha"], [199, 120, 40], 128),
        ([100, 128], ["assocalpha"], [199] * 3, 128),
        ([100, 128], ["unspecified"], [100] * 3, None),
    ],
)
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_extra_samples_of_a_tiff(
    tmp_path: Path, pixel: list[int], kinds: list[str], colors: list[int], alpha: int | None, depth: type[np.generic]
) -> None:
    values = np.broadcast_to(np.array(pixel, depth) * (257 if depth == np.uint16 else 1), (4, 6, len(pixel)))
    photometric = "rgb" if len(pixel) > 2 else "minisblack"
    how: dict[str, Any] = {"photometric": photometric, "extrasamples": kinds, "planarconfig": "contig"}
    tifffile.imwrite(tmp_path / "a.tif", values.astype(depth), **how)
    assert as_read(tmp_path / "a.tif") == (colors, alpha)


@pytest.mark.parametrize(
    ("name", "mode"),
    [*((f"a.{end}", "RGBA") for end in ("png", "webp", "bmp", "tif")), ("a.png", "LA"), ("a.tif", "LA")],
)
def test_alpha_that_is_straight_in_the_file(tmp_path: Path, name: str, mode: str) -> None:
    image = Image.new("RGBA", (6, 4), (100, 60, 20, 128)).convert(mode)
    image.save(tmp_path / name, lossless=True)
    assert as_read(tmp_path / name) == (np.asarray(image.convert("RGB"))[0, 0].tolist(), 128)


def test_a_float_tiff_with_values_of_8_bits(tmp_path: Path) -> None:
    values = np.full((4, 6, 3), 128, np.float32)
    values[:, :4] = 0  # most of it is black
    values[0, 5] = 217.5
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb")
    with pytest.raises(
        SceneError,
        match=r"a\.tif: expected linear light from 0 to 1, got float values up to 217\.5; divide them.*view 3",
    ):
        read_image(tmp_path / "a.tif", "view 3")
    tifffile.imwrite(tmp_path / "a.tif", values / 255, photometric="rgb")
    assert read_image(tmp_path / "a.tif", "view 3")[0][3, 5].tolist() == [188] * 3  # 128 / 255 is 0.502


def says_srgb(path: Path) -> bool:
    """Return whether a file says that it is sRGB; not every file type has a place for it."""
    import OpenImageIO

    return str(present(OpenImageIO.ImageInput.open(str(path))).spec().getattribute("oiio:ColorSpace")).startswith(
        "srgb"
    )


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_cmyk_agrees_with_pillow(tmp_path: Path, suffix: str) -> None:
    image = Image.fromarray(RNG.integers(0, 256, (16, 24, 3), dtype=np.uint8)).resize((48, 32)).convert("CMYK")
    image.save(tmp_path / f"a{suffix}")
    colors, alpha = read_image(tmp_path / f"a{suffix}", "test")
    with Image.open(tmp_path / f"a{suffix}") as opened:
        assert np.abs(colors.astype(int) - np.asarray(opened.convert("RGB"))).max() <= 3
    assert alpha is None


@pytest.mark.parametrize("orientation", range(1, 9))
def test_upright_agrees_with_pillow(tmp_path: Path, orientation: int) -> None:
    pixels = RNG.integers(0, 256, (6, 9, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    picture = read_picture(tmp_path / "a.png", "test")
    np.testing.assert_array_equal(picture.colors, pixels)
    with Image.open(tmp_path / "a.png") as opened:
        np.testing.assert_array_equal(upright(picture.colors, picture.orientation), ImageOps.exif_transpose(opened))


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L"])
def test_heic_agrees_with_pillow(tmp_path: Path, mode: str) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    image = Image.fromarray(RNG.integers(0, 256, (4, 6, 4), dtype=np.uint8)).resize((96, 64)).convert(mode)
    pillow_heif.from_pillow(image).save(tmp_path / "a.heic", quality=90)
    colors, alpha = read_image(tmp_path / "a.heic", "test")
    assert image_size(tmp_path / "a.heic", "test") == (96, 64) and colors.shape == (64, 96, 3)
    # What lossy coding does to smooth colours.
    assert np.abs(colors.astype(int) - np.asarray(image.convert("RGB"))).mean() < 4
    assert (alpha is not None) == (mode == "RGBA")


@pytest.mark.parametrize(("written", "named"), [("a.heic", "a.jpg"), ("a.jpg", "b.heic"), ("a.png", "b.heic")])
def test_content_and_not_the_name_tells_the_kind(tmp_path: Path, written: str, named: str) -> None:
    """Check that the content tells the kind, as phones and messengers rename photographs."""
    pillow_heif = pytest.importorskip("pillow_heif")
    image = Image.new("RGB", (96, 64), (200, 100, 50))
    (pillow_heif.from_pillow(image) if written == "a.heic" else image).save(tmp_path / written)
    shutil.copy(tmp_path / written, tmp_path / named)
    colors, _ = read_image(tmp_path / named, "test")
    assert image_size(tmp_path / named, "test") == (96, 64)
    assert np.abs(colors.astype(int) - [200, 100, 50]).max() <= 3, "what lossy coding does"


def test_truncated_jpeg(tmp_path: Path) -> None:
    Image.fromarray(RNG.integers(0, 256, (90, 120, 3), dtype=np.uint8)).save(tmp_path / "a.jpg")
    data = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(data[: len(data) // 2])
    with pytest.raises(
        SceneError, match=r"a\.jpg: the image is damaged: .*Premature end.*named by view 3.*copy it again"
    ):
        read_image(tmp_path / "a.jpg", "view 3")


@pytest.mark.parametrize(("cut", "message"), [(20, "this file is not a readable image"), (400, "the image is damaged")])
def test_truncated_heic(tmp_path: Path, cut: int, message: str) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.from_pillow(Image.new("RGB", (96, 64))).save(tmp_path / "a.heic")
    (tmp_path / "a.heic").write_bytes((tmp_path / "a.heic").read_bytes()[:cut])
    with pytest.raises(SceneError, match=rf"(?s)a\.heic: {message}.*named by view 3.*; copy it again"):
        read_image(tmp_path / "a.heic", "view 3")


def test_a_heic_whose_header_lies_about_its_colors(tmp_path: Path) -> None:
    """Check a HEIC that opens, but on which pillow-heif raises SyntaxError when it decodes (found by fuzzing)."""
    pillow_heif = pytest.importorskip("pillow_heif")
    path = tmp_path / "a.heic"
    pillow_heif.from_pillow(Image.new("RGB", (96, 64))).save(path)
    whole = bytearray(path.read_bytes())
    whole[whole.index(b"hvcC") + 20] &= 0xFC  # chroma_format_idc of ISO/IEC 14496-15: monochrome
    path.write_bytes(whole)
    assert image_size(path, "view 3") == (96, 64)
    with pytest.raises(SceneError, match=r"a\.heic: the image is damaged: .*named by view 3.*; copy it again"):
        read_image(path, "view 3")


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.exr", "a.heic"])
def test_wrong_magic(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"GIF89 no, not really an image at all")
    with pytest.raises(SceneError, match=rf"{name}: this file is not a readable image: .*named by view 3"):
        read_image(tmp_path / name, "view 3")


def test_images_too_large_for_any_machine_are_refused_by_their_header(tmp_path: Path) -> None:
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
    with pytest.raises(SceneError, match=r"a\.png: .*image size 28610.* MB exceeds.*named by view 3\); reduce it"):
        read_image(tmp_path / "a.png", "view 3")


def test_large_images_below_the_limit_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.new("RGB", (40, 25)).save(tmp_path / "a.png")
    monkeypatch.setattr(images, "MAX_PIXELS", 1000)
    assert image_size(tmp_path / "a.png", "test") == (40, 25)
    monkeypatch.setattr(images, "MAX_PIXELS", 999)
    with pytest.raises(SceneError, match="40x25 pixels exceed the limit of 999 in one image; reduce it"):
        image_size(tmp_path / "a.png", "test")


def test_mask_in_an_alpha_channel(tmp_path: Path) -> None:
    pixels = np.zeros((4, 4, 4), np.uint8)
    pixels[1:3, 1:3, 3] = 255
    Image.fromarray(pixels).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", "test"), pixels[..., 3])


def test_area_reduction_by_whole_factors_is_the_mean() -> None:
    image = RNG.random((12, 8, 3)).astype(np.float32)
    expected = image.reshape(4, 3, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(reduce_area(image, 4, 4), expected, rtol=1e-5)


def test_area_reduction_by_fractions() -> None:
    """Check five pixels reduced to two: each takes two and a half."""
    image = np.arange(5, dtype=np.float32)[None, :, None]
    np.testing.assert_allclose(reduce_area(image, 2, 1)[0, :, 0], [(0 + 1 + 1) / 2.5, (1 + 3 + 4) / 2.5], rtol=1e-6)


def test_white() -> None:
    colors = np.full((1, 1, 3), 100, np.uint8)
    assert composite_on_white(colors, np.array([[0]], np.uint8)).max() == 255
    np.testing.assert_array_equal(composite_on_white(colors, np.array([[51]], np.uint8)), np.full((1, 1, 3), 224))


def test_a_heic_that_holds_no_image_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that such a file is refused: pillow-heif opens it, and fails on its first image (found by fuzzing)."""
    import pillow_heif

    path = tmp_path / "a.heic"
    path.write_bytes(b"\0\0\0\x18ftypheic")
    monkeypatch.setattr(pillow_heif, "open_heif", lambda *_, **__: [][0])
    with pytest.raises(SceneError, match="not a readable image: list index"):
        read_picture(path, "test")


@pytest.mark.parametrize("reason", ["line after line\n" * 5000, "one line " * 5000])
def test_what_libraries_say_is_cut_short(reason: str) -> None:
    """Check that long messages are cut short.

    Fuzzing found that a damaged TIFF gives thousands of lines, and a damaged zip the bytes of its first file.
    """
    assert len(in_short(reason)) < 210
    assert "\n" not in in_short(reason)
