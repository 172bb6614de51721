"""Photographs grouped by camera, by EXIF that Pillow writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from PIL.Image import Exif
from PIL.TiffImagePlugin import IFDRational
from pillow_heif import from_pillow

from mgsr.data.camera_tags import CameraTags, read_tags
from mgsr.data.images import image_size
from mgsr.data.shared_lenses import PhotoFile, describe_lenses, share_lenses

# Exif 2.32: tags of the main directory, and of the Exif directory that it points to.
MAKE, MODEL, ORIENTATION, EXIF = 0x010F, 0x0110, 0x0112, 0x8769
FOCAL, FOCAL_35MM, ZOOM, SERIAL, LENS = 0x920A, 0xA405, 0xA404, 0xA431, 0xA434

PHONE = {MAKE: "Apple", MODEL: "iPhone 12"}
WIDE = {FOCAL: IFDRational(42, 10), FOCAL_35MM: 26, LENS: "back camera 4.2mm f/1.6"}
ULTRA = {FOCAL: IFDRational(155, 100), FOCAL_35MM: 14, LENS: "back camera 1.55mm f/2.4"}


def exif(main: dict[int, Any], more: dict[int, Any]) -> Image.Exif:
    tags = Image.Exif()
    tags.update(main)
    tags.get_ifd(EXIF).update(more)
    return tags


def write(path: Path, tags: Image.Exif | None = None, size: tuple[int, int] = (40, 30)) -> Path:
    """Write a HEIC by pillow-heif, which turns it by its orientation, or any other kind by Pillow."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.new("RGB", size, (200, 100, 50))
    data = b"" if tags is None else tags.tobytes()
    if path.suffix == ".heic":
        from_pillow(image).save(path, exif=data or None)
    else:
        image.save(path, exif=data)
    return path


def groups(root: Path) -> list[list[str]]:
    return [[shot.name for shot in lens.shots] for lens in share_lenses(shots(root))]


def shots(root: Path) -> list[PhotoFile]:
    paths = sorted(path for path in root.rglob("*") if path.is_file())
    return [PhotoFile(path.relative_to(root).as_posix(), image_size(path, "test"), read_tags(path)) for path in paths]


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".heic"])
def test_the_tags_that_another_library_wrote_are_read(tmp_path: Path, suffix: str) -> None:
    tags = exif(PHONE, {**WIDE, ZOOM: IFDRational(15, 10), SERIAL: "C39"})
    read = read_tags(write(tmp_path / f"a{suffix}", tags))
    assert (read.make, read.model, read.lens, read.serial) == ("Apple", "iPhone 12", WIDE[LENS], "C39")
    assert (read.focal, read.focal_35mm, read.zoom) == pytest.approx((4.2, 26, 1.5))


def test_one_phone_shares_a_lens_however_it_was_turned(tmp_path: Path) -> None:
    for name, turned in (("a.jpg", 1), ("b.jpg", 6), ("c.jpg", 3), ("sub/d.jpg", 8)):
        write(tmp_path / name, exif({**PHONE, ORIENTATION: turned}, WIDE))
    assert groups(tmp_path) == [["a.jpg", "b.jpg", "c.jpg", "sub/d.jpg"]]
    assert describe_lenses(share_lenses(shots(tmp_path))) == "one camera: Apple iPhone 12, 40x30"


@pytest.mark.parametrize(
    "other",
    [
        exif({**PHONE, MODEL: "iPhone 13"}, WIDE),
        exif({**PHONE, MAKE: "Banana"}, WIDE),
        exif(PHONE, ULTRA),
        exif(PHONE, {**WIDE, LENS: "front camera"}),
        exif(PHONE, {**WIDE, FOCAL: IFDRational(5, 1)}),
        exif(PHONE, {**WIDE, FOCAL_35MM: 52}),
        exif(PHONE, {**WIDE, ZOOM: IFDRational(2, 1)}),
        exif(PHONE, {**WIDE, SERIAL: "other body"}),
        None,
    ],
)
def test_what_tells_cameras_and_zooms_apart(tmp_path: Path, other: Exif | None) -> None:
    write(tmp_path / "a.jpg", exif(PHONE, WIDE))
    write(tmp_path / "b.jpg", other)
    write(tmp_path / "c.jpg", exif(PHONE, WIDE))
    assert groups(tmp_path) == [["a.jpg", "c.jpg"], ["b.jpg"]]


def test_pixels_that_are_stored_turned_have_another_lens(tmp_path: Path) -> None:
    write(tmp_path / "a.jpg", exif(PHONE, WIDE))
    write(tmp_path / "b.jpg", exif(PHONE, WIDE), size=(30, 40))
    write(tmp_path / "c.heic", exif({**PHONE, ORIENTATION: 6}, WIDE))
    assert groups(tmp_path) == [["a.jpg"], ["b.jpg", "c.heic"]], "HEIC is turned when it is decoded"


def test_no_digital_zoom_is_written_in_three_ways(tmp_path: Path) -> None:
    for name, zoom in (("a", {}), ("b", {ZOOM: IFDRational(0, 1)}), ("c", {ZOOM: IFDRational(1, 1)})):
        write(tmp_path / f"{name}.jpg", exif(PHONE, {**WIDE, **zoom}))
    write(tmp_path / "d.jpg", exif(PHONE, {**WIDE, ZOOM: IFDRational(0, 0)}))
    assert len(groups(tmp_path)) == 1


def test_without_exif_size_and_folder_tell(tmp_path: Path) -> None:
    for name in ("left/1.png", "left/2.png", "right/1.png"):
        write(tmp_path / name)
    write(tmp_path / "right/2.png", size=(20, 30))
    assert groups(tmp_path) == [["left/1.png", "left/2.png"], ["right/1.png"], ["right/2.png"]]
    assert describe_lenses(share_lenses(shots(tmp_path))) == (
        "3 cameras: left, 40x30 (2 photographs); right, 40x30 (1 photograph); right, 20x30 (1 photograph)"
    )


def test_an_orientation_alone_is_no_camera(tmp_path: Path) -> None:
    write(tmp_path / "a.jpg", exif({ORIENTATION: 6}, {}))
    write(tmp_path / "b.jpg")
    assert groups(tmp_path) == [["a.jpg", "b.jpg"]]


def test_cameras_are_told_apart_in_words(tmp_path: Path) -> None:
    for i, (name, focal) in enumerate((("Canon", 24), ("Canon", 35), ("Canon", 50), ("Canon", 70), ("Canon", 85))):
        tags = exif({MAKE: name, MODEL: "Canon EOS R5"}, {FOCAL: IFDRational(focal, 1)})
        write(tmp_path / f"{i}.jpg", tags)
    line = describe_lenses(share_lenses(shots(tmp_path)))
    assert line.startswith("5 cameras: Canon EOS R5, 40x30 at 24 mm (1 photograph); Canon EOS R5, 40x30 at 35 mm")
    assert line.endswith("; and 1 more")


@pytest.mark.parametrize("suffix", [".jpg", ".heic"])
def test_damaged_exif_is_no_error(tmp_path: Path, suffix: str) -> None:
    good = exif({**PHONE, MAKE: "Caméra"}, WIDE).tobytes()
    for i in range(0, len(good), 7):
        broken = good[:i] + bytes([255 - good[i]]) + good[i + 1 :]
        path = tmp_path / f"{i}{suffix}"
        if suffix == ".heic":
            from_pillow(Image.new("RGB", (8, 8))).save(path, exif=broken[: len(good) - i // 3])
        else:
            Image.new("RGB", (8, 8)).save(path, exif=broken[: len(good) - i // 3])
        assert isinstance(read_tags(path), CameraTags)


def test_focal_length_in_pixels_by_the_diagonal() -> None:
    """Check a frame of 36 x 24 mm, whose diagonal is 43.27 mm, against 3000 x 4000 pixels, whose diagonal is 5000."""
    assert CameraTags(focal_35mm=43.27).focal_pixels((3000, 4000)) == pytest.approx(5000)
    assert CameraTags(focal=4.2).focal_pixels((3000, 4000)) is None
