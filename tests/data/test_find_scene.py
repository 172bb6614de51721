"""Finding the scene in what people give, and the message where there is none."""

from __future__ import annotations

import re
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mgsr.config import DataConfig
from mgsr.data.photo_files import SceneFolder
from mgsr.data.readers import find_capture, load_scene
from mgsr.errors import MissingPhotoError, SceneError
from tests.data.captures import BallCapture, edit_json, save
from tests.data.reading import read_capture

LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 123\n"
GREY = np.full((8, 8, 3), 128, np.uint8)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return BallCapture().write_plain(tmp_path / "vase")


def views(path: Path) -> int:
    scene = load_scene(path, DataConfig())
    return len(scene.train) + len(scene.test)


def refuses(path: Path, match: str) -> None:
    with pytest.raises(SceneError, match=match):
        load_scene(path, DataConfig())


@pytest.mark.parametrize("place", ["a", "a/b", "a/b/c"])
def test_a_scene_some_folders_deeper(tmp_path: Path, root: Path, place: str) -> None:
    deeper = tmp_path / "given" / place / "vase"
    deeper.parent.mkdir(parents=True)
    root.rename(deeper)
    scene = load_scene(tmp_path / "given", DataConfig())
    assert scene.name == "vase" and scene.root == deeper


def test_photographs_beside_the_folder_of_the_cameras(tmp_path: Path) -> None:
    """Check that photographs and masks are found beside the cameras' folder, as dense/0/sparse and images/ lie."""
    root = BallCapture().write_plain(tmp_path / "vase", mode="RGB")
    BallCapture().write_masks(root)
    (root / "export/0").mkdir(parents=True)
    (root / "cameras.json").rename(root / "export/0/cameras.json")
    scene = load_scene(root, DataConfig())
    assert scene.name == "export" and len(scene.train) + len(scene.test) == 12
    assert scene.masked and scene.notes == ()


def test_a_scene_given_by_its_photographs(root: Path) -> None:
    scene = load_scene(root / "photos", DataConfig())
    assert scene.name == "vase" and scene.notes[0] == "photos is a part of the scene vase, so vase is read"
    save(root / "others/a.png", GREY, "RGB")
    refuses(root / "others", "1 images but no cameras; at least 3 are needed to find cameras")


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("moved", [False, True])
def test_absolute_paths(root: Path, monkeypatch: pytest.MonkeyPatch, relative: bool, moved: bool) -> None:
    """Check that the result does not depend on an absolute or relative folder, nor on a move."""

    def absolute(content: dict[str, Any]) -> None:
        for view in content["views"]:
            view["image"] = str(root / view["image"])

    edit_json(root / "cameras.json", absolute)
    folder = root.rename(root.with_name("moved")) if moved else root
    monkeypatch.chdir(folder.parent)
    scene = load_scene(Path(folder.name) if relative else folder, DataConfig())
    assert len(scene.train) + len(scene.test) == 12
    assert [note for note in scene.notes if "are in other folders" in note] == (
        [note for note in scene.notes if note.startswith("12 of 12 photographs are in other folders")] if moved else []
    )
    assert bool(scene.notes) == moved


def test_absolute_paths_outside_are_never_read(root: Path, tmp_path: Path) -> None:
    save(tmp_path / "secret/000.png", GREY, "RGB")
    edit_json(root / "cameras.json", lambda content: content["views"][0].update(image=str(tmp_path / "secret/1.png")))
    scene = load_scene(root, DataConfig())
    assert any("secret/1.png is missing" in note for note in scene.notes)


def test_windows_paths(root: Path) -> None:
    def windows(content: dict[str, Any]) -> None:
        for view in content["views"]:
            view["image"] = "D:\\captures\\vase\\" + view["image"].replace("/", "\\")

    edit_json(root / "cameras.json", windows)
    assert views(root) == 12


def test_reduced_copies(root: Path) -> None:
    """Check that the largest copies are used where the photographs themselves are gone."""
    for factor in (8, 2, 4):
        shutil.copytree(root / "photos", root / f"photos_{factor}")
    shutil.rmtree(root / "photos")
    scene = load_scene(root, DataConfig())
    assert "the photographs are read from photos_2; the cameras are scaled to the photographs' size" in scene.notes


def test_photographs_that_may_be_several(tmp_path: Path) -> None:
    for name in ("left", "right"):
        save(tmp_path / name / "0.png", GREY, "RGB")
        save(tmp_path / name / "1.png", GREY, "RGB")
    folder = SceneFolder.at(tmp_path)
    found = folder.find_photos("poses.txt", ["a/left/0.png", "right/1.png", "2.png"])
    assert found.paths[:2] == [tmp_path / "left/0.png", tmp_path / "right/1.png"]
    assert isinstance(found.paths[2], MissingPhotoError)
    both = folder.find_photos("poses.txt", ["0.png"]).paths[0]
    assert re.match(r"poses\.txt: the photograph '0\.png' may be left/0\.png or right/0\.png; write its", str(both))


def test_depth_maps_of_the_same_names_are_no_photographs(tmp_path: Path) -> None:
    for folder in ("depth", "rgb"):
        save(tmp_path / folder / "0.png", GREY, "RGB")
    assert SceneFolder.at(tmp_path).find_photos("poses.txt", ["0"], labels=True).paths == [tmp_path / "rgb/0.png"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("walk.avi", "x", r"walk\.avi is a video of a kind that is not read; convert it with `ffmpeg"),
        ("walk.mp4", "x", r"walk\.mp4: expected an MP4, MOV, WebM or Matroska video"),
        ("a.png", "x", r"a\.png: this is a single photograph; use the folder"),
        ("scene.zip", LFS, r"scene\.zip is a pointer of Git LFS, not the file itself; .*`git lfs pull`"),
        ("scene.zip", "<!DOCTYPE html><html>", r"scene\.zip is a web page, not the file itself; download the file"),
        ("scene.zip", "", r"scene\.zip is an empty file"),
        ("transforms.json", "{}", r"transforms\.json: this is one file of a scene; use the folder that holds it"),
    ],
)
def test_files_that_are_no_scene(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    refuses(tmp_path / name, message)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("walk.WMV", r"a video \(walk\.WMV\) of a kind that is not read; convert it"),
        ("walk.MOV", r"walk\.MOV: expected an MP4, MOV, WebM or Matroska video"),
        ("IMG.dng", r"raw photographs \(IMG\.dng\), which MGSR does not read; convert them"),
        ("scene.zip", r"it holds no known scene but another archive, scene\.zip"),
    ],
)
def test_folders_of_other_things(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / name).write_text("x")
    refuses(tmp_path, message)


def test_git_lfs_pointers_in_place_of_files(root: Path) -> None:
    (root / "photos/003.png").write_text(LFS)
    scene = load_scene(root, DataConfig())
    assert len(scene.train) + len(scene.test) == 11
    assert any(re.search(r"003\.png is a pointer of Git LFS, .*git lfs pull", note) for note in scene.notes)
    for path in (root / "photos").iterdir():
        path.write_text(LFS)
    refuses(root, r"12 of 12 photographs cannot be used; the first: .*is a pointer of Git LFS")
    (root / "cameras.json").write_text(LFS)
    refuses(root, r"cameras\.json is a pointer of Git LFS")


def test_an_archive_whose_scene_lies_deeper(root: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "vase.zip", "w") as archive:
        for path in sorted(root.rglob("*")):
            archive.write(path, Path("upload/today") / path.relative_to(root))
    assert views(tmp_path / "vase.zip") == 12


def test_nan_as_windows_writes_it(root: Path) -> None:
    """Check that one view's NaN, as Windows writes it in JSON, loses that view."""
    text = (root / "cameras.json").read_text()
    text = re.sub(r'(?<="cam_from_world": \[\[)[-\d.e]+', "-nan(ind)", text, count=1)
    (root / "cameras.json").write_text(text)
    scene = load_scene(root, DataConfig())
    assert scene.notes[0].startswith("1 of 12 photographs skipped: cameras.json, view 0 (photos/000.png): the pose has")


@pytest.mark.parametrize("folder", ["depth", "masks_4", "mono_normal", "old", "photos_2"])
def test_a_missing_photograph_is_not_replaced_by_another_image_of_its_name(root: Path, folder: str) -> None:
    for path in (root / "photos").iterdir():
        save(root / folder / path.name, GREY, "RGB")
    (root / "photos/003.png").unlink()
    scene = load_scene(root, DataConfig())
    assert scene.notes[0] == "1 of 12 photographs of cameras.json skipped: photos/003.png is missing"
    assert len(scene.train) + len(scene.test) == 11


def test_a_file_serves_one_photograph(tmp_path: Path) -> None:
    """Check that a file serves one of a rig's two photographs of one name.

    One of them is missing, and the other was converted.
    """
    for number in range(4):
        save(tmp_path / f"cam0/{number}.png", GREY, "RGB")
        save(tmp_path / f"cam1/{number}.png", GREY, "RGB")
    (tmp_path / "cam0/3.png").unlink()
    names = [f"cam{camera}/{number}.jpg" for camera in range(2) for number in range(4)]
    found = SceneFolder.at(tmp_path).find_photos("poses.txt", names)
    expected = [tmp_path / name.replace("jpg", "png") for name in names]
    assert [path for path in found.paths if isinstance(path, Path)] == expected[:3] + expected[4:]
    assert isinstance(found.paths[3], MissingPhotoError)


def test_developed_photographs_beside_raw_ones(root: Path) -> None:
    for path in sorted((root / "photos").iterdir()):
        path.with_suffix(".CR2").write_text("raw")

    def raw(content: dict[str, Any]) -> None:
        for view in content["views"]:
            view["image"] = view["image"].replace(".png", ".CR2")

    edit_json(root / "cameras.json", raw)
    assert views(root) == 12
    shutil.rmtree(root / "photos")
    refuses(
        root,
        r"12 of 12 photographs cannot be used; the first: photos/000\.CR2: MGSR does not read raw photographs; convert",
    )


@pytest.mark.parametrize("name", ["{}/masks/{:03d}.png", "elsewhere/masks/{:03d}.png", "C:\\moved\\Masks\\{:03d}.png"])
def test_paths_of_masks_follow_those_of_photographs(tmp_path: Path, name: str) -> None:
    root = BallCapture().write_plain(tmp_path / "vase", mode="RGB")
    BallCapture().write_masks(root)

    def named(content: dict[str, Any]) -> None:
        for i, view in enumerate(content["views"]):
            view["mask"] = name.format(root, i) if name.startswith("{}") else name.format(i)

    edit_json(root / "cameras.json", named)
    assert load_scene(root, DataConfig()).masked


@pytest.mark.parametrize("part", ["images", "images/left", "output/sparse", "output/sparse/0", "output"])
def test_a_scene_given_by_a_part_of_it(tmp_path: Path, part: str) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera.create_from_model_name(1, "PINHOLE", 100.0, 64, 64))
    ball = BallCapture(views=9)
    for i, pose in enumerate(ball.poses(), start=1):
        save(tmp_path / f"vase/images/left/{i}.png", ball.rgba(pose), "RGB")
        image = pycolmap.Image(name=f"left/{i}.png", camera_id=1, image_id=i)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    (tmp_path / "vase/output/sparse/0").mkdir(parents=True)
    model.write_binary(str(tmp_path / "vase/output/sparse/0"))
    scene = load_scene(tmp_path / "vase" / part, DataConfig())
    assert len(scene.train) + len(scene.test) == 9
    assert scene.notes[0] == f"{Path(part).name} is a part of the scene {scene.name}, so {scene.name} is read"


def test_one_mask_for_two_photographs_is_used_for_none(root: Path) -> None:
    for camera in ("left", "right"):
        for number in range(6):
            source = root / f"photos/{number + 6 * (camera == 'right'):03d}.png"
            save(root / camera / f"{number}.png", np.asarray(Image.open(source).convert("RGB")), "RGB")
            save(root / f"masks/{number}.png", GREY[..., 0] * 0, "L")

    def rig(content: dict[str, Any]) -> None:
        for i, view in enumerate(content["views"]):
            view["image"] = f"{'left' if i < 6 else 'right'}/{i % 6}.png"

    edit_json(root / "cameras.json", rig)
    scene = load_scene(root, DataConfig())
    assert not scene.masked and scene.notes[0].startswith(
        "masks/0.png may be the mask of several photographs, so it is ignored"
    )


def test_extensions_in_capitals(root: Path) -> None:
    (root / "cameras.json").unlink()
    (root / "CAMS.CSV").write_text("#name,x,y,alt,heading,pitch,roll,f\n" + "photos/000.png,0,0,10,0,0,0,18\n" * 2)
    assert len(read_capture(root, "realitycapture").photos) == 2


@pytest.mark.parametrize("cameras", [True, False], ids=["cameras alone", "photographs alone"])
def test_a_confined_scene_takes_nothing_from_outside(tmp_path: Path, root: Path, cameras: bool) -> None:
    """Check that a job of the service can't reach the files of another."""
    inner = tmp_path / "vase/job"
    inner.mkdir()
    if cameras:
        (root / "cameras.json").rename(inner / "cameras.json")
    else:
        (root / "photos").rename(inner / "photos")
        edit_json(root / "cameras.json", lambda c: [v.update(image="job/" + v["image"]) for v in c["views"]])
    assert views(inner) == 12
    confined = DataConfig(confined=True)
    if not cameras:
        assert find_capture(inner, confined).kind is None, "photographs without cameras"
        return
    with pytest.raises(SceneError, match="only 0 of the 12 photographs"):
        load_scene(inner, confined)
