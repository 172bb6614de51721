"""Photographs made into views: turned, their masks fitted, told of while they load, held in memory or in files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image, ImageOps

from mgsr.config import DataConfig, Masks
from mgsr.data import loading
from mgsr.data.capture import Photo
from mgsr.data.files import ImageIndex, find_image, images_below
from mgsr.data.lens import Lens
from mgsr.data.loading import load_views, settle_masks
from mgsr.data.mask_files import MaskIndex
from mgsr.data.pixels import PixelStore
from mgsr.errors import SceneError
from tests.data.captures import BallCapture, save
from tests.data.reading import read_capture

RNG = np.random.default_rng(11)
K = np.array([[80.0, 0, 30], [0, 80, 20], [0, 0, 1]])


def photo(path, size=(60, 40), **values) -> Photo:
    return Photo(path, K, size, np.eye(4), f"test, view {path.stem}", **values)


def load(*photos, config=DataConfig(max_side=1600)):  # noqa: B008 (frozen)
    return [item.view for item in load_views(photos, [item.image.stem for item in photos], config)]


# EXIF orientation


@pytest.fixture
def sideways(tmp_path):
    """Stored 40x60, upright 60x40."""
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(RNG.integers(0, 256, (60, 40, 3), dtype=np.uint8)).save(tmp_path / "a.png", exif=exif)
    return tmp_path / "a.png"


def test_a_photograph_is_turned_where_only_its_upright_form_fits_the_camera(sideways):
    with Image.open(sideways) as opened:
        expected = np.asarray(ImageOps.exif_transpose(opened))
    (view,) = load(photo(sideways))
    np.testing.assert_array_equal(view.image, expected)
    assert (view.camera.width, view.camera.height) == (60, 40)


def test_a_photograph_calibrated_as_it_is_stored_stays_so(sideways):
    """As in COLMAP, which does not look at the orientation."""
    (view,) = load(photo(sideways, size=(40, 60)))
    np.testing.assert_array_equal(view.image, np.asarray(Image.open(sideways)))


@pytest.mark.parametrize("stored", [True, False])
def test_the_mask_of_a_turned_photograph(sideways, stored):
    """Masks have no orientation of their own: the shape tells whether they were drawn on stored or upright pixels."""
    upright = np.zeros((40, 60), np.uint8)
    upright[:10, :25] = 255
    Image.fromarray(np.rot90(upright) if stored else upright).save(sideways.with_name("m.png"))
    (view,) = load(photo(sideways, mask=sideways.with_name("m.png")))
    np.testing.assert_array_equal(view.alpha, upright)


# Masks


@pytest.mark.parametrize("scale", [2, 0.5])
def test_masks_of_another_size_and_the_same_shape(tmp_path, scale):
    Image.new("RGB", (60, 40)).save(tmp_path / "a.png")
    mask = np.zeros((int(40 * scale), int(60 * scale)), np.uint8)
    mask[: int(20 * scale), : int(30 * scale)] = 255
    Image.fromarray(mask).save(tmp_path / "m.png")
    (view,) = load(photo(tmp_path / "a.png", mask=tmp_path / "m.png"))
    expected = np.zeros((40, 60), bool)
    expected[:20, :30] = True
    np.testing.assert_array_equal(view.alpha > 127, expected)


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
def test_names_of_masks(tmp_path, name):
    for path in ("images/left/0001.jpg", "images/left/0002.jpg", name):
        save(tmp_path / path, np.zeros((4, 4), np.uint8), "L")
    index = MaskIndex(tmp_path)
    assert index.find(tmp_path / "images/left/0001.jpg") == tmp_path / name
    assert index.find(tmp_path / "images/left/0002.jpg") is None
    assert [path.name for path in images_below(tmp_path)] == ["0001.jpg", "0002.jpg"]


def masked_views(tmp_path, change):
    ball = BallCapture(views=6)
    photos = []
    for i, pose in enumerate(ball.poses()):
        save(tmp_path / f"{i}.png", ball.rgba(pose), "RGB")
        save(tmp_path / f"m{i}.png", change(ball.rgba(pose)[..., 3]), "L")
        photos.append(Photo(tmp_path / f"{i}.png", ball.K, (64, 64), pose, f"view {i}", tmp_path / f"m{i}.png"))
    return load_views(photos, [str(i) for i in range(6)], DataConfig())


def test_inverted_masks_are_noticed(tmp_path):
    loaded = masked_views(tmp_path, lambda mask: 255 - mask)
    with pytest.raises(SceneError, match=r"the masks are inverted: white around the object.*masks=off"):
        settle_masks(loaded, [], Masks.AUTO)
    assert settle_masks(loaded, [], Masks.OFF).train[0].alpha is None


@pytest.mark.parametrize("fill", [0, 255])
def test_good_masks_are_not_taken_for_inverted_ones(tmp_path, fill):
    """Of objects with a hole, and of those that fill the picture but for some specks."""

    def change(mask):
        mask = mask if fill == 0 else np.full_like(mask, 255)
        mask[30:34, 30:34] = 0
        return mask

    assert settle_masks(masked_views(tmp_path, change), [], Masks.AUTO).train[0].alpha is not None


# Names


def test_photographs_by_label(tmp_path):
    for name in ("a/IMG_1.JPG", "a/IMG_2.png", "b/img_2.PNG", "masks/IMG_3.png"):
        save(tmp_path / name, np.zeros((4, 4), np.uint8), "L")
    index = ImageIndex(tmp_path)
    assert index.find("img_1", "test") == index.find("C:\\dir\\IMG_1.jpg", "test") == tmp_path / "a/IMG_1.JPG"
    assert index.find("IMG_1.tif", "test") == tmp_path / "a/IMG_1.JPG"
    assert index.find("IMG_3", "test") is None
    with pytest.raises(SceneError, match=r"'IMG_2' may be a/IMG_2\.png, b/img_2\.PNG; leave one"):
        index.find("IMG_2", "test")


@pytest.mark.parametrize("asked", ["Photos/a.JPG", "photos/u\u0308.png", "photos/\u00fc", "photos/b", "photos/B.jpeg"])
def test_photographs_whose_names_other_systems_write_otherwise(tmp_path, asked):
    """Windows and macOS don't tell large from small letters, and macOS writes accents as marks of their own."""
    for name in ("photos/A.jpg", "photos/\u00fc.png", "photos/b.png", "photos/b.jpeg"):
        save(tmp_path / name, np.zeros((4, 4), np.uint8), "L")
    expected = {"a": "A.jpg", "u": "\u00fc.png", "\u00fc": "\u00fc.png", "b": "b.png", "B": "b.jpeg"}
    assert find_image(tmp_path, asked, "test") == tmp_path / "photos" / expected[asked[7]]


def test_a_linked_folder_of_photographs_is_looked_into_once(tmp_path):
    save(tmp_path / "elsewhere/a.png", np.zeros((4, 4), np.uint8), "L")
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene/photos").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere/again").symlink_to(tmp_path / "scene")
    assert images_below(tmp_path / "scene") == [tmp_path / "scene/photos/a.png"]


# Many photographs


def test_progress_comes_while_photographs_load(tmp_path, monkeypatch):
    monkeypatch.setattr(loading, "_REPORT_EVERY", -1)
    for i in range(5):
        Image.new("RGB", (60, 40)).save(tmp_path / f"{i}.png")
    told = []
    photos = [photo(tmp_path / f"{i}.png") for i in range(5)]
    load_views(photos, "abcde", DataConfig(), lambda done, total: told.append((done, total)))
    assert told == [(i, 5) for i in range(1, 6)]


def test_a_bad_photograph_stops_the_others(tmp_path, monkeypatch):
    """Nobody wants to wait for a thousand photographs to hear that the first is damaged."""
    decoded = []
    read = loading.read_picture
    monkeypatch.setattr(loading, "read_picture", lambda *given: (decoded.append(given), read(*given))[1])
    Image.new("RGB", (60, 40)).save(tmp_path / "good.png")
    (tmp_path / "bad.png").write_text("hello")
    with pytest.raises(SceneError, match=r"bad\.png"):
        load(photo(tmp_path / "bad.png"), *[photo(tmp_path / "good.png")] * 300)
    assert len(decoded) < 200


def test_photographs_of_one_camera_share_one_map(tmp_path, monkeypatch):
    made = []
    original = loading.Undistorter.__call__
    monkeypatch.setattr(loading.Undistorter, "__call__", lambda *given: (made.append(original(*given)), made[-1])[1])
    Image.new("RGB", (60, 40)).save(tmp_path / "a.png")
    load(*[photo(tmp_path / "a.png", lens=Lens(0.1))] * 4)
    assert len(made) == 4 and len({id(how) for how in made}) == 1


@pytest.mark.parametrize("memory", [0, 300, 1 << 20])
def test_the_store_gives_back_what_it_got(memory):
    """In memory, in files, and where the one goes over into the other."""
    store = PixelStore(memory, file=128)
    images = [RNG.integers(0, 256, (RNG.integers(1, 9), RNG.integers(1, 9), 3), dtype=np.uint8) for _ in range(40)]
    images.append(RNG.integers(0, 256, (20, 20, 3), dtype=np.uint8))  # larger than a file
    held = [store.hold(image) for image in images]
    for image, copy in zip(images, held, strict=True):
        np.testing.assert_array_equal(copy, image)
        copy[...] = 0  # torch wants arrays that can be written to
    assert not np.shares_memory(held[0], held[1])


def test_names_in_files_that_no_file_can_have(tmp_path):
    root = BallCapture(views=3).write_plain(tmp_path)
    for name in ("a\0b.png", "a/" * 3000 + "b.png", "n" * 5000 + ".png", "n" * 250):
        content = json.loads((root / "cameras.json").read_text())
        content["views"][1]["image"] = name
        (root / "cameras.json").write_text(json.dumps(content))
        with pytest.raises(SceneError, match=r"view 1: .*for a file's name; mend the file"):
            read_capture(root, "plain")
