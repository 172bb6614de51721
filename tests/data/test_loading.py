"""Loading photographs into views: turning, fitting masks, reporting progress, and memory or files as storage."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageOps

from mgsr.config import DataConfig, Masks
from mgsr.data import loading
from mgsr.data.capture import Photo
from mgsr.data.files import images_below
from mgsr.data.images import read_picture
from mgsr.data.lens import Lens
from mgsr.data.loading import LoadedView, load_views
from mgsr.data.mask_files import MaskIndex
from mgsr.data.photo_files import SceneFolder
from mgsr.data.pixels import PixelStore
from mgsr.data.scene import View
from mgsr.data.settle_masks import settle_masks
from mgsr.data.undistortion import Undistorter
from mgsr.errors import MissingPhotoError, SceneError
from tests.data.captures import BallCapture, save
from tests.data.reading import read_capture
from tests.optional import present

RNG = np.random.default_rng(11)
K = np.array([[80.0, 0, 30], [0, 80, 20], [0, 0, 1]])


def photo(path: Path, size: tuple[int, int] = (60, 40), **values: Any) -> Photo:
    return Photo(path, K, size, np.eye(4), f"test, view {path.stem}", **values)


def load(*photos: Photo, config: DataConfig = DataConfig(max_side=1600)) -> list[View]:  # noqa: B008 (frozen)
    return [item.view for item in load_items(*photos, config=config)]


def load_items(*photos: Photo, config: DataConfig = DataConfig(max_side=1600)) -> list[LoadedView]:  # noqa: B008 (frozen)
    return [loaded(item) for item in load_views(photos, [item.image.stem for item in photos], config)]


def loaded(item: LoadedView | SceneError) -> LoadedView:
    """Return a view that must not have failed to load."""
    assert isinstance(item, LoadedView)
    return item


# EXIF orientation


@pytest.fixture
def sideways(tmp_path: Path) -> Path:
    """Write a photograph that is stored 40x60 and upright 60x40."""
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(RNG.integers(0, 256, (60, 40, 3), dtype=np.uint8)).save(tmp_path / "a.png", exif=exif)
    return tmp_path / "a.png"


def test_a_photograph_is_turned_where_only_its_upright_form_fits_the_camera(sideways: Path) -> None:
    with Image.open(sideways) as opened:
        expected = np.asarray(ImageOps.exif_transpose(opened))
    (view,) = load(photo(sideways))
    np.testing.assert_array_equal(view.image, expected)
    assert (view.camera.width, view.camera.height) == (60, 40)


def test_a_photograph_calibrated_as_it_is_stored_stays_so(sideways: Path) -> None:
    """Check that the photograph stays as stored, as in COLMAP, which ignores the orientation."""
    (view,) = load(photo(sideways, size=(40, 60)))
    np.testing.assert_array_equal(view.image, np.asarray(Image.open(sideways)))


@pytest.mark.parametrize("stored", [True, False])
def test_the_mask_of_a_turned_photograph(sideways: Path, stored: bool) -> None:
    """Check masks drawn on stored or upright pixels: they have no orientation of their own, so their shape decides."""
    upright = np.zeros((40, 60), np.uint8)
    upright[:10, :25] = 255
    Image.fromarray(np.rot90(upright) if stored else upright).save(sideways.with_name("m.png"))
    (item,) = load_items(photo(sideways, mask=sideways.with_name("m.png")))
    np.testing.assert_array_equal(item.mask, upright)


# Masks


@pytest.mark.parametrize("scale", [2, 0.5])
def test_masks_of_another_size_and_the_same_shape(tmp_path: Path, scale: float) -> None:
    Image.new("RGB", (60, 40)).save(tmp_path / "a.png")
    mask = np.zeros((int(40 * scale), int(60 * scale)), np.uint8)
    mask[: int(20 * scale), : int(30 * scale)] = 255
    Image.fromarray(mask).save(tmp_path / "m.png")
    (item,) = load_items(photo(tmp_path / "a.png", mask=tmp_path / "m.png"))
    expected = np.zeros((40, 60), bool)
    expected[:20, :30] = True
    np.testing.assert_array_equal(present(item.mask) > 127, expected)


@pytest.mark.parametrize(
    "name",
    [
        "masks/0001.png",
        "masks/0001.jpg.png",
        "masks/0001_mask.png",
        "masks/0001.mask.png",
        "mask/0001.png",
        "masks/left/0001.png",
        "masks/images/left/0001.jpg.png",
        "masks/mask_0001.png",
        "masks/0001.PNG",
        "masks/0001.tif",
        "Masks/0001.png",
        "masks/LEFT/0001.Png",
        "images/left/0001.jpg.mask.png",
        "images/left/0001.mask.png",
    ],
)
def test_names_of_masks(tmp_path: Path, name: str) -> None:
    for path in ("images/left/0001.jpg", "images/left/0002.jpg", name):
        save(tmp_path / path, np.zeros((4, 4), np.uint8), "L")
    index = MaskIndex(SceneFolder.at(tmp_path))
    assert index.find(tmp_path / "images/left/0001.jpg") == tmp_path / name
    assert index.find(tmp_path / "images/left/0002.jpg") is None
    assert [path.name for path in images_below(tmp_path)] == ["0001.jpg", "0002.jpg"]


def masked_views(tmp_path: Path, change: Callable[[np.ndarray], np.ndarray]) -> list[LoadedView]:
    ball = BallCapture(views=6)
    photos = []
    for i, pose in enumerate(ball.poses()):
        save(tmp_path / f"{i}.png", ball.rgba(pose), "RGB")
        save(tmp_path / f"m{i}.png", change(ball.rgba(pose)[..., 3]), "L")
        photos.append(Photo(tmp_path / f"{i}.png", ball.K, (64, 64), pose, f"view {i}", tmp_path / f"m{i}.png"))
    return [loaded(item) for item in load_views(photos, [str(i) for i in range(6)], DataConfig())]


def test_inverted_masks_are_noticed(tmp_path: Path) -> None:
    loaded = masked_views(tmp_path, lambda mask: 255 - mask)
    with pytest.raises(SceneError, match=r"the masks are inverted, white around the object.*masks=off"):
        settle_masks(loaded, [], Masks.AUTO)
    assert settle_masks(loaded, [], Masks.OFF).train[0].alpha is None


def test_masks_of_objects_with_a_hole_are_not_taken_for_inverted_ones(tmp_path: Path) -> None:
    def change(mask: np.ndarray) -> np.ndarray:
        mask[30:34, 30:34] = 0
        return mask

    assert settle_masks(masked_views(tmp_path, change), [], Masks.AUTO).train[0].alpha is not None


def test_masks_that_are_white_but_for_some_specks_are_no_silhouettes(tmp_path: Path) -> None:
    def change(mask: np.ndarray) -> np.ndarray:
        mask[:] = 255
        mask[30:34, 30:34] = 0
        return mask

    (view, *_) = settle_masks(masked_views(tmp_path, change), [], Masks.AUTO).train
    assert view.valid_mask is not None
    assert view.alpha is None and not view.valid_mask[30:34, 30:34].any() and view.valid_mask.sum() == 64 * 64 - 6 * 6


# Names


def test_photographs_by_label(tmp_path: Path) -> None:
    for name in ("a/IMG_1.JPG", "a/IMG_2.png", "b/img_2.PNG", "masks/IMG_3.png"):
        save(tmp_path / name, np.zeros((4, 4), np.uint8), "L")

    def find(label: str) -> Path | SceneError:
        return SceneFolder.at(tmp_path).find_photos("labels", [label], labels=True).paths[0]

    assert find("img_1") == find("C:\\dir\\IMG_1.jpg") == find("IMG_1.tif") == tmp_path / "a/IMG_1.JPG"
    assert isinstance(find("IMG_3"), MissingPhotoError)
    assert find("b/IMG_2") == tmp_path / "b/img_2.PNG"
    assert re.match(r"labels: the photograph 'IMG_2' may be a/IMG_2\.png or b/img_2\.PNG; write", str(find("IMG_2")))


@pytest.mark.parametrize("asked", ["Photos/a.JPG", "photos/u\u0308.png", "photos/\u00fc", "photos/b", "photos/B.jpeg"])
def test_photographs_whose_names_other_systems_write_otherwise(tmp_path: Path, asked: str) -> None:
    """Check that names match without regard to case and accent encoding.

    Windows and macOS ignore case, and macOS writes accents as marks of their own.
    """
    for name in ("photos/A.jpg", "photos/\u00fc.png", "photos/b.png", "photos/b.jpeg"):
        save(tmp_path / name, np.zeros((4, 4), np.uint8), "L")
    expected = {"a": "A.jpg", "u": "\u00fc.png", "\u00fc": "\u00fc.png", "b": "b.png", "B": "b.jpeg"}
    found = SceneFolder.at(tmp_path).find_photos("test", [asked])
    assert found.paths == [tmp_path / "photos" / expected[asked[7]]] and found.notes == ()


def test_a_linked_folder_of_photographs_is_looked_into_once(tmp_path: Path) -> None:
    save(tmp_path / "elsewhere/a.png", np.zeros((4, 4), np.uint8), "L")
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene/photos").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere/again").symlink_to(tmp_path / "scene")
    assert images_below(tmp_path / "scene") == [tmp_path / "scene/photos/a.png"]


# Many photographs


def test_progress_comes_while_photographs_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loading, "_REPORT_EVERY", -1)
    for i in range(5):
        Image.new("RGB", (60, 40)).save(tmp_path / f"{i}.png")
    reported = []
    photos = [photo(tmp_path / f"{i}.png") for i in range(5)]
    load_views(photos, "abcde", DataConfig(), lambda done, total: reported.append((done, total)))
    assert reported == [(i, 5) for i in range(1, 6)]


def test_a_bad_photograph_is_told_of_and_loses_no_other(tmp_path: Path) -> None:
    Image.new("RGB", (60, 40)).save(tmp_path / "good.png")
    (tmp_path / "bad.png").write_text("hello")
    good = photo(tmp_path / "good.png")
    photos = [good, photo(tmp_path / "bad.png"), good]
    first, bad, last = load_views(photos, ["first", "bad", "last"], DataConfig())
    assert isinstance(first, LoadedView) and isinstance(last, LoadedView)
    assert first.view.image.shape == last.view.image.shape == (40, 60, 3)
    assert isinstance(bad, SceneError) and "bad.png: this file is not a readable image" in str(bad)


def test_bad_photographs_stop_the_others_once_they_are_the_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that loading stops early: nobody wants to wait for a thousand photographs to hear that they are damaged."""
    decoded = []
    read = read_picture

    def noted(path: Path, *rest: Any) -> Any:
        decoded.append(path)
        if path.name == "good.png":
            time.sleep(0.01)  # as long as one takes, so that who counts the bad ones has time to say stop
        return read(path, *rest)

    monkeypatch.setattr(loading, "read_picture", noted)
    Image.new("RGB", (60, 40)).save(tmp_path / "good.png")
    (tmp_path / "bad.png").write_text("hello")
    with pytest.raises(SceneError, match=r"bad\.png"):
        load(*[photo(tmp_path / "bad.png")] * 160, *[photo(tmp_path / "good.png")] * 140)
    assert len(decoded) < 250


def test_photographs_of_one_camera_share_one_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    original = Undistorter.__call__

    def noted(*given: Any) -> Any:
        made.append(original(*given))
        return made[-1]

    monkeypatch.setattr(Undistorter, "__call__", noted)
    Image.new("RGB", (60, 40)).save(tmp_path / "a.png")
    load(*[photo(tmp_path / "a.png", lens=Lens(0.1))] * 4)
    assert len(made) == 4 and len({id(how) for how in made}) == 1


@pytest.mark.parametrize("memory", [0, 300, 1 << 20])
def test_the_store_gives_back_what_it_got(memory: int) -> None:
    """Check images in memory, in files, and where memory runs out in between."""
    store = PixelStore(memory, file=128)
    images: list[np.ndarray] = [
        RNG.integers(0, 256, (RNG.integers(1, 9), RNG.integers(1, 9), 3), dtype=np.uint8) for _ in range(40)
    ]
    images.append(RNG.integers(0, 256, (20, 20, 3), dtype=np.uint8))  # larger than a file
    images += [RNG.integers(0, 2, (3, 5)) > 0, np.flatnonzero(images[0] > 9), RNG.integers(0, 256, 7, dtype=np.uint8)]
    held = [store.hold(image) for image in images]
    for image, copy in zip(images, held, strict=True):
        np.testing.assert_array_equal(copy, image)
        copy[...] = 0  # torch wants arrays that can be written to
    assert not np.shares_memory(held[0], held[1])


def test_names_in_files_that_no_file_can_have(tmp_path: Path) -> None:
    root = BallCapture(views=3).write_plain(tmp_path)
    for name in ("a\0b.png", "a/" * 3000 + "b.png", "n" * 5000 + ".png", "n" * 250):
        content = json.loads((root / "cameras.json").read_text())
        content["views"][1]["image"] = name
        (root / "cameras.json").write_text(json.dumps(content))
        (lost,) = read_capture(root, "plain").lost
        assert re.search("a file name may not be so long or have a zero byte; fix the file", str(lost))
