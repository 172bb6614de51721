"""What a worker writes of the photographs for the page."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mgsr.data.scene import Scene, Similarity, View
from mgsr.inspection.inspect import inspect_scene, photo_names
from mgsr.pipeline.progress import Event
from service.contract.photographs import CheckedPhotographs
from tests.inspection.room import FOCAL, HEIGHT, WIDTH, Room, room_cameras, room_scene
from worker.reporting import Reporter

MIDDLE = np.array([5.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def room() -> Room:
    return Room.drawn()


@pytest.fixture(scope="module")
def scene(room: Room) -> Scene:
    return replace(room_scene(room.views), user_from_scene=Similarity(2.0, MIDDLE))


def reported(folder: Path, *events: Event) -> CheckedPhotographs:
    reporter = Reporter(folder, lambda kind, **data: None, lambda event: None)
    for event in events:
        reporter(event)
    return CheckedPhotographs.model_validate_json((folder / "photographs.json").read_text())


def tile(found: CheckedPhotographs, path: Path, index: int) -> np.ndarray:
    """Return a photograph's square of a sheet [tile,tile,4]; Pillow reads it."""
    sheet = np.asarray(Image.open(io.BytesIO(path.read_bytes())).convert("RGBA"))
    row, column = divmod(index, found.columns)
    return sheet[row * found.tile :, column * found.tile :][: found.tile, : found.tile]


def small(image: np.ndarray, size: int) -> np.ndarray:
    return np.asarray(Image.fromarray(image).resize((size, size * HEIGHT // WIDTH), Image.Resampling.BOX))


def grey(image: np.ndarray) -> np.ndarray:
    """Return the light of a picture; WebP keeps colours at half the size."""
    return np.asarray(Image.fromarray(image).convert("L")).astype(float)


def test_cameras_and_pictures_of_a_check(scene: Scene, room: Room, tmp_path: Path) -> None:
    inspection = inspect_scene(scene)
    found = reported(tmp_path, Event("check", "", inspection=inspection, scene=scene))
    assert [photo.name for photo in found.photographs] == photo_names(scene)
    assert (found.middle, found.radius, found.masks) == (tuple(MIDDLE), 2.0, False)
    assert not (tmp_path / "masks.webp").exists()
    for index, camera in ((0, room_cameras()[0]), (17, room_cameras()[17])):
        photo = found.photographs[index]
        assert np.allclose(photo.center, 2 * camera.center + MIDDLE)
        assert np.allclose(photo.direction, -camera.center / np.linalg.norm(camera.center))
        assert abs(np.dot(photo.up, photo.direction)) < 1e-9 and photo.up[2] > 0.7
        assert photo.angles[0] == pytest.approx(2 * np.degrees(np.arctan(WIDTH / 2 / FOCAL)), abs=0.01)
        shown = tile(found, tmp_path / "photographs.webp", index)
        edge = (found.tile - found.tile * HEIGHT // WIDTH) // 2
        assert (shown[: edge - 1, :, 3] == 0).all() and (shown[edge + 1 : -edge - 1, :, 3] == 255).all()
        expected = small(room.views[index].image, found.tile)
        assert np.abs(grey(shown[edge:-edge, :, :3]) - grey(expected)).mean() < 4, "WebP loses some"


def test_masks_that_come_with_the_photographs_or_later(scene: Scene, room: Room, tmp_path: Path) -> None:
    inspection = inspect_scene(scene)
    views = [replace(view, alpha=mask) for view, mask in zip(room.views, room.masks, strict=True)]
    masked = replace(scene, train=views[:-4], test=views[-4:], user_from_scene=Similarity(0.7, MIDDLE))
    first = Event("check", "", inspection=inspection, scene=scene)
    found = reported(tmp_path, first, Event("object", "found", scene=masked))
    assert found.masks and found.radius == 0.7
    edge = (found.tile - found.tile * HEIGHT // WIDTH) // 2
    plain = tile(found, tmp_path / "photographs.webp", 3)[edge:-edge, :, :3].astype(float)
    shown = tile(found, tmp_path / "masks.webp", 3)[edge:-edge, :, :3].astype(float)
    inside = small(room.masks[3], found.tile) > 250
    outside = small(room.masks[3], found.tile) < 5
    assert np.abs(shown - plain)[inside].mean() < 8
    assert shown[outside].mean() < 0.5 * plain[outside].mean()
    other = reported(tmp_path / "other", Event("check", "", inspection=inspect_scene(masked), scene=masked))
    assert other.masks and (tmp_path / "other/masks.webp").is_file()


def test_a_photograph_that_was_left_out_has_no_mask(scene: Scene, room: Room, tmp_path: Path) -> None:
    inspection = inspect_scene(scene)
    views = [View(view.name, view.camera, view.image, mask) for view, mask in zip(room.views, room.masks, strict=True)]
    fewer = replace(scene, train=views[1:-4], test=views[-4:])
    found = reported(tmp_path, Event("check", "", inspection=inspection, scene=scene), Event("object", "", scene=fewer))
    assert (tile(found, tmp_path / "masks.webp", 0)[..., 3] == 0).all()
    assert (tile(found, tmp_path / "masks.webp", 1)[64, :, 3] == 255).all()
