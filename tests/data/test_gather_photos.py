"""What COLMAP is given: the photographs' own files, or PNG with the same pixels."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO
import pytest
from PIL import Image
from pillow_heif import from_pillow

from mgsr.data.find_poses import find_poses
from mgsr.data.gather_photos import Gathered, find_photos, gather
from mgsr.errors import SceneError
from tests.data.reading import draw

pycolmap = pytest.importorskip("pycolmap")  # after OpenImageIO: the two do not bear the other order

COLOR = (200, 100, 50)
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"


def plain(path: Path, color: tuple[int, ...] = COLOR) -> None:
    Image.new("RGB", (32, 24), color).save(path)


def by_openimageio(path: Path, dtype: str = "uint8") -> None:
    out = OpenImageIO.ImageOutput.create(str(path))
    assert out is not None
    assert out.open(str(path), OpenImageIO.ImageSpec(32, 24, 3, dtype))
    values = np.array(COLOR) / 255
    linear = ((values + 0.055) / 1.055) ** 2.4 if dtype in ("float", "half") else values  # IEC 61966-2-1
    out.write_image(np.broadcast_to(linear.astype(np.float32), (24, 32, 3)).copy())
    out.close()


def by_hand_as_psd(path: Path) -> None:
    """Write a PSD by Adobe's specification: a header, three empty sections, and planes without compression."""
    header = b"8BPS" + struct.pack(">H6xHIIHH", 1, 3, 24, 32, 8, 3)
    planes = b"".join(bytes([value]) * (32 * 24) for value in COLOR)
    path.write_bytes(header + struct.pack(">III", 0, 0, 0) + struct.pack(">H", 0) + planes)


WRITERS = {
    **dict.fromkeys(["jpg", "jpeg", "jfif", "png", "bmp", "tif", "tga", "ppm", "pnm"], plain),
    **dict.fromkeys(["webp", "jp2", "j2k", "gif"], plain),
    **dict.fromkeys(["exr", "hdr"], lambda path: by_openimageio(path, "float")),
    "dpx": by_openimageio,
    "heic": lambda path: from_pillow(Image.new("RGB", (32, 24), COLOR)).save(path),
    "psd": by_hand_as_psd,
}
AS_THEY_ARE = ["jpg", "jpeg", "jfif", "png", "bmp", "tif", "tga", "ppm", "pnm"]


def gathered(folder: Path, names: Sequence[str]) -> Gathered:
    return gather(folder, [folder / name for name in names], folder.parent / "images")


@pytest.mark.parametrize("suffix", WRITERS)
def test_colmap_reads_every_kind_as_it_is(tmp_path: Path, suffix: str) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    names = [f"{i}.{suffix}" for i in range(3)]
    for name in names:
        WRITERS[suffix](photos / name)
    found = gathered(photos, names)
    linked = suffix in AS_THEY_ARE
    assert [shot.name for shot in found.shots] == (names if linked else ["0.png", "1.png", "2.png"])
    assert all(shot.size == (32, 24) for shot in found.shots) and found.notes == ()
    given = tmp_path / "images" / found.shots[0].name
    assert given.samefile(photos / names[0]) == linked
    seen = pycolmap.Bitmap.read(str(given), True).to_array()
    assert np.abs(seen[9, 9].astype(int) - COLOR).max() <= 3, "what lossy coding does"


def test_names_that_lie(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    from_pillow(Image.new("RGB", (32, 24), COLOR)).save(tmp_path / "a.heic")
    (tmp_path / "a.heic").rename(photos / "a.jpg")
    Image.new("RGB", (32, 24), COLOR).save(photos / "b.jpg", "WEBP")
    plain(photos / "c.png")
    assert [shot.name for shot in gathered(photos, ["a.jpg", "b.jpg", "c.png"]).shots] == ["a.png", "b.png", "c.png"]


def test_conversion_keeps_alpha_and_takes_8_bits(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    pixels = np.zeros((24, 32, 4), np.uint8)
    pixels[...] = (*COLOR, 77)
    Image.fromarray(pixels).save(photos / "a.webp", lossless=True, exact=True)
    cv2.imwrite(str(photos / "b.jp2"), np.full((128, 128, 3), 0x8080, np.uint16))
    plain(photos / "c.png")
    gathered(photos, ["a.webp", "b.jp2", "c.png"])
    with Image.open(tmp_path / "images/a.png") as image:
        assert image.mode == "RGBA" and image.getpixel((9, 9)) == (*COLOR, 77)
    with Image.open(tmp_path / "images/b.png") as image:
        assert image.mode == "RGB" and np.abs(np.asarray(image, int)[9, 9] - 128).max() <= 1


def test_names_do_not_collide_after_conversion(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    names = ["a.gif", "a.PNG", "a.webp", "a_gif.png"]
    for i, name in enumerate(names):
        plain(photos / name, (60 * i, 0, 0))
    found = gathered(photos, names)
    assert [shot.name for shot in found.shots] == ["a_gif_2.png", "a.PNG", "a_webp.png", "a_gif.png"]
    for i, shot in enumerate(found.shots):
        with Image.open(tmp_path / "images" / shot.name) as image:
            assert abs(int(np.asarray(image.convert("RGB"))[9, 9, 0]) - 60 * i) <= 3


def test_what_is_no_photograph_is_left_out_with_its_cure(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for i in range(9):
        draw(photos / f"{i}.png")
    odd = {
        "cut.jpg": b"\xff\xd8\xff\xe0",
        "empty.png": b"",
        "film.heic": struct.pack(">I", 24) + b"ftypisom\0\0\2\0isommp42" + bytes(99),
        "pointer.png": POINTER.encode(),
    }
    for name, content in odd.items():
        (photos / name).write_bytes(content)
    names = [f"{i}.png" for i in range(9)]
    for name, reason in (
        ("cut.jpg", "not a readable image"),
        ("empty.png", "empty.png is an empty file; copy or download it again"),
        ("film.heic", "film.heic is a video, not a photograph; give a video without photographs"),
        ("pointer.png", "pointer.png is a pointer of Git LFS, .*`git lfs pull`"),
    ):
        found = gather(photos, [photos / item for item in [*names, name]], tmp_path / name / "images")
        assert len(found.shots) == 9 and len(found.notes) == 1
        with pytest.raises(
            AssertionError,
            match=rf"1 of 10 photographs cannot be read and were skipped \({name}\); the first: .*{reason}",
        ):
            raise AssertionError(found.notes[0])


def test_equal_names_in_several_folders(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    for side in ("left", "right"):
        (photos / side).mkdir(parents=True)
        draw(photos / side / "1.png")
        draw(photos / side / "2.png")
        (photos / side / "3.png").touch()
    found = gather(photos, find_photos(photos, photos), tmp_path / "images")
    assert [shot.name for shot in found.shots] == ["left/1.png", "left/2.png", "right/1.png", "right/2.png"]
    assert found.notes[0].startswith("2 of 6 photographs cannot be read and were skipped (left/3.png, right/3.png)")


def test_damage_of_most_is_an_error(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for i in range(7):
        if i < 3:
            draw(photos / f"{i}.png")
        else:
            (photos / f"{i}.png").write_text(POINTER)
    with pytest.raises(
        SceneError, match=r"4 of 7 photographs cannot be read; the first: 3\.png is a pointer of Git LFS"
    ):
        find_poses(photos, tmp_path / "scene", 0, lambda text: None)
    assert not (tmp_path / "scene").exists()


def test_a_video_instead_of_photographs(tmp_path: Path) -> None:
    film = tmp_path / "photos/clip.mp4"
    film.parent.mkdir()
    film.write_bytes(b"film")
    with pytest.raises(SceneError, match=r"clip\.mp4: expected an MP4, MOV, WebM or Matroska video"):
        find_poses(film, tmp_path / "scene", 0)
    with pytest.raises(
        SceneError, match=r"photos: it holds 0 images, .*; 1 video \(clip\.mp4\) skipped; give a video without"
    ):
        find_photos(film.parent, film.parent)


def test_raw_photographs_instead_of_developed_ones(tmp_path: Path) -> None:
    for name in ("a.NEF", "b.NEF"):
        (tmp_path / name).write_bytes(b"raw")
    with pytest.raises(SceneError, match=r"2 raw photographs \(a\.NEF, \.\.\.\) skipped; convert"):
        find_photos(tmp_path, tmp_path)


def test_films_and_raw_files_beside_their_photographs_are_no_loss(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for i in range(3):
        draw(photos / f"IMG_{i}.png")
        (photos / f"IMG_{i}.MOV").write_bytes(b"film")
        (photos / f"img_{i}.dng").write_bytes(b"raw")
    assert gather(photos, find_photos(photos, photos), tmp_path / "images").notes == ()
