"""Captures without cameras: photographs and videos of a room's corner, whose cameras are known."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pillow_heif import from_pillow

from mgsr.config import DataConfig
from mgsr.data import find_cameras
from mgsr.data.camera_search import CameraSearch
from mgsr.data.readers import find_capture, load_scene
from mgsr.data.scene import Scene
from mgsr.errors import Cancelled, ConfigError, SceneError
from tests.data.corner import K, camera_errors, picture, poses, save_pictures
from tests.data.films import film
from tests.data.reading import draw, read_capture

importlib.import_module("OpenImageIO")  # before pycolmap, as in the program: the two don't bear the other order
pycolmap = pytest.importorskip("pycolmap")


def cameras_of(scene: Scene) -> np.ndarray:
    """Return cam_from_world [N,4,4] of all views in the user's frame, by name."""
    views = sorted((*scene.train, *scene.test), key=lambda view: view.name)
    return np.array([scene.user_from_scene.camera_to_user(view.camera).cam_from_world for view in views])


def broken(*arguments: object) -> None:
    raise AssertionError("the search begins anew")


def stop_at(share: float) -> Callable[[float], None]:
    def tell(done: float) -> None:
        if done >= share:
            raise Cancelled("stopped on request")

    return tell


@pytest.mark.slow
def test_photographs_become_a_scene_and_are_searched_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_pictures(tmp_path / "room/photos")
    shares: list[float] = []
    search = CameraSearch(tmp_path / "cameras", resume=True, tell=shares.append)
    scene = load_scene(tmp_path / "room", search=search)
    assert (scene.name, scene.format, len(scene.train), len(scene.test)) == ("room", "photographs", 7, 1)
    assert any(note.startswith("the cameras were found from the photographs") for note in scene.notes)
    place, turn = camera_errors(cameras_of(scene), np.array(poses()))
    assert place.max() < 0.05 and turn.max() < 1, "one per cent of the distance"
    assert shares == sorted(shares) and shares[-1] <= 1 and len(shares) > 8
    assert not (tmp_path / "cameras/database.db").exists()

    monkeypatch.setattr(find_cameras, "find_model", broken)
    again = load_scene(tmp_path / "room", search=search)
    assert np.array_equal(cameras_of(again), cameras_of(scene)) and again.notes == scene.notes
    known = CameraSearch(tmp_path / "cameras", known_only=True, seed=7)
    assert np.array_equal(cameras_of(load_scene(tmp_path / "room", search=known)), cameras_of(scene))

    # The found cameras beside the photographs are a scene of COLMAP's form.
    shutil.copytree(tmp_path / "cameras/sparse", tmp_path / "room/photos/sparse")
    assert len(read_capture(tmp_path / "room/photos", "colmap").photos) == 8
    shutil.rmtree(tmp_path / "room/photos/sparse")
    with pytest.raises(AssertionError, match="begins anew"):
        load_scene(tmp_path / "room", DataConfig(camera_per_image=True), search=search)


@pytest.mark.slow
def test_an_interrupted_search_goes_on(tmp_path: Path) -> None:
    save_pictures(tmp_path / "room")
    folder = tmp_path / "cameras"
    with pytest.raises(Cancelled):
        load_scene(tmp_path / "room", search=CameraSearch(folder, tell=stop_at(0.5)))
    assert not json.loads((folder / "search.json").read_text())["finished"]
    before = (folder / "database.db").stat().st_size
    with pycolmap.Database.open(str(folder / "database.db")) as kept:
        features = kept.num_keypoints()
    assert features > 1000 and before > 50_000

    with pytest.raises(Cancelled):
        load_scene(tmp_path / "room", search=CameraSearch(folder, resume=True, tell=stop_at(0.9)))
    with pycolmap.Database.open(str(folder / "database.db")) as kept:
        assert kept.num_keypoints() == features and kept.num_verified_image_pairs() > 5
    scene = load_scene(tmp_path / "room", search=CameraSearch(folder, resume=True))
    assert camera_errors(cameras_of(scene), np.array(poses()))[0].max() < 0.05


@pytest.mark.slow
def test_a_video_becomes_a_scene(tmp_path: Path) -> None:
    path = film(tmp_path / "walk.webm", [picture(pose) for pose in poses(60)])
    scene = load_scene(path, search=CameraSearch(tmp_path / "cameras"))
    assert (scene.name, scene.format) == ("walk", "video")
    assert any("frames of walk.webm are used" in note for note in scene.notes)
    frames = sorted((tmp_path / "cameras/images").iterdir())
    numbers = [int(frame.stem.removeprefix("frame_")) for frame in frames]
    assert len(scene.train) + len(scene.test) == len(frames) >= 10
    place, _ = camera_errors(cameras_of(scene), np.array(poses(60))[numbers])
    assert place.max() < 0.1, "two per cent of the distance"
    assert len(read_capture(tmp_path / "cameras", "colmap").photos) == len(frames), "they are a scene of their own"


@pytest.mark.slow
def test_converted_photographs_keep_their_names(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    for number, pose in enumerate(poses()):
        shown = Image.fromarray(np.ascontiguousarray(picture(pose)[..., ::-1]))
        from_pillow(shown).save(tmp_path / f"room/{number}.heic", quality=95)
    scene = load_scene(tmp_path / "room", search=CameraSearch(tmp_path / "cameras"))
    assert len(scene.train) + len(scene.test) == 8
    model = pycolmap.Reconstruction(str(tmp_path / "cameras/sparse/0"))
    assert sorted(image.name for image in model.images.values()) == [f"{number}.heic" for number in range(8)]
    assert abs(next(iter(model.cameras.values())).focal_length / K[0, 0] - 1) < 0.03


def test_pictures_without_texture_say_how_many_and_leave_nothing(tmp_path: Path) -> None:
    for number in range(4):
        draw(tmp_path / f"photos/{number}.png")
    with pytest.raises(
        SceneError, match="only 0 of 4 photographs have a camera; take more photographs of a still, textured scene"
    ):
        load_scene(tmp_path / "photos", search=CameraSearch(tmp_path / "out/cameras"))
    assert not (tmp_path / "out/cameras").exists()


def test_without_pycolmap_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        draw(tmp_path / f"photos/{number}.png")
    monkeypatch.setitem(importlib.import_module("sys").modules, "pycolmap", None)
    with pytest.raises(ConfigError, match=r"requires pycolmap; install it with `pip install 'mgsr\[poses\]'`"):
        load_scene(tmp_path / "photos", search=CameraSearch(tmp_path / "cameras"))
    assert not (tmp_path / "cameras").exists()


def test_results_without_cameras(tmp_path: Path) -> None:
    for number in range(3):
        draw(tmp_path / f"photos/{number}.png")
    with pytest.raises(SceneError, match=r"photographs without cameras, and .*cameras has no cameras of them; finish"):
        load_scene(tmp_path / "photos", search=CameraSearch(tmp_path / "cameras", known_only=True))


def test_what_counts_as_a_capture_without_cameras(tmp_path: Path) -> None:
    draw(tmp_path / "two/a.png")
    draw(tmp_path / "two/b.png")
    with pytest.raises(SceneError, match="it holds 2 images but no cameras; at least 3 are needed to find cameras"):
        find_capture(tmp_path / "two")
    film(tmp_path / "two/walk.mp4", [np.zeros((48, 64, 3), np.uint8)])
    found = find_capture(tmp_path / "two")
    assert found.kind is None and found.is_video
    draw(tmp_path / "two/c.png")
    found = find_capture(tmp_path / "two")
    assert found.kind is None and not found.is_video
    (tmp_path / "two/transforms.json").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n")
    with pytest.raises(SceneError, match=r"transforms\.json is a pointer of Git LFS"):
        load_scene(tmp_path / "two")


@pytest.mark.slow
def test_a_walk_around_a_toy(tmp_path: Path, shared_data: Path) -> None:
    """Check the cameras of 56 JPEGs against the true ones: all are placed, within 0.15% of the distance in the mean."""
    capture, photos = shared_data / "handheld/hand_spot", tmp_path / "spot"
    photos.mkdir()
    for path in sorted((capture / "images").iterdir()):
        (photos / path.name).write_bytes(path.read_bytes())
    scene = load_scene(photos, search=CameraSearch(tmp_path / "cameras"))
    frames = json.loads((capture / "transforms.json").read_text())["frames"]
    frames.sort(key=lambda frame: frame["file_path"])
    assert len(scene.train) + len(scene.test) == len(frames) == 56
    world_from_camera = np.array([frame["transform_matrix"] for frame in frames]) @ np.diag([1.0, -1.0, -1.0, 1.0])
    distance = np.linalg.norm(world_from_camera[:, :3, 3], axis=1).mean()
    place, turn = camera_errors(cameras_of(scene), np.linalg.inv(world_from_camera))
    assert place.mean() < 0.0015 * distance and turn.max() < 0.3
