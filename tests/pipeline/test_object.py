"""Runs that reconstruct the object of a capture without masks alone, on a table that a ray tracer draws."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mgsr
from mgsr.config import make_config
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import ConfigError, MgsrError
from mgsr.export.scenes import write_scene
from mgsr.pipeline import preprocess
from mgsr.pipeline.object_files import with_found_object
from mgsr.pipeline.progress import ignore
from mgsr.pipeline.run import run_scene
from mgsr.pipeline.single_steps import mesh_again, score_again
from mgsr.pipeline.steps import StepClock, Steps
from mgsr.segmentation.object_masks import NoObject
from tests.segmentation.table_scene import TABLE, table_scene

pytestmark = pytest.mark.usefixtures("quick_report")

SIZE = 72  # of photographs, in pixels
SHORT = [
    "warmup.surfel_iterations=100",
    "warmup.gaussian_iterations=30",
    "mutual.iterations=20",
    "model_selection.iterations=0",
]
FEW = [
    "exposure=keep",
    "surfels.max_start=4000",
    "gaussians.max_start=2000",
    "environment_map.iterations=0",
    "max_environment_ratio=0",
    "mesh.poisson_depth=6",
    "expert.segmentation.search.iterations=300",
    "expert.segmentation.search.rounds=2",
    "expert.mesh.choice.max_start_residual=0",  # so short a training ends so near the start that chance would choose
]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide the folder of a capture without masks."""
    folder = tmp_path_factory.mktemp("capture") / "table"
    folder.mkdir()
    write_scene(folder, table_scene(SIZE)[0], 1.0)
    return folder


@pytest.fixture(scope="module")
def done(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide the results of a short run that looks for the object."""
    out = tmp_path_factory.mktemp("out")
    run_scene(capture, out, make_config(overrides=[*SHORT, *FEW, "object=auto"]), "cpu")
    return out


def test_the_object_alone_is_delivered(done: Path) -> None:
    import trimesh

    low, high = trimesh.load_mesh(done / "mesh.ply", process=False).bounds
    assert (np.abs(np.stack([low, high])[:, :2]) < 0.55).all() and low[2] > TABLE - 0.06 and high[2] < 0.75
    report = json.loads((done / "report.json").read_text())
    assert report["input"]["masks_found"] and any("the object was found" in note for note in report["input"]["notes"])


def test_renders_have_a_background(done: Path, capture: Path) -> None:
    """Check the object before its background against the photograph, and against a background of one colour."""
    scene, (_, truth) = load_scene(capture), table_scene(SIZE)
    plain = 255 * np.array(json.loads((done / "object.json").read_text())["background_color"])
    for view, mask in zip(scene.test, truth[len(scene.train) :], strict=True):
        shown = np.array(Image.open(done / "renders" / "test" / f"{view.name}_whole.png")).astype(float)
        apart = np.abs(shown - view.image).mean(axis=-1)
        empty = np.abs(plain - view.image).mean(axis=-1)
        assert apart[~mask].mean() < 0.4 * empty[~mask].mean() and apart[mask].mean() < 20
    report = json.loads((done / "report.json").read_text())
    assert report["psnr_whole_test"] == pytest.approx(np.mean([v["psnr_whole"] for v in report["views"].values()]))
    assert "The found object" in (done / "report.html").read_text()
    camera = scene.user_from_scene.camera_to_user(scene.test[0].camera)
    again = mgsr.render(mgsr.load_result(done), camera).whole
    written = np.array(Image.open(done / "renders" / "test" / f"{scene.test[0].name}_whole.png"))
    assert again is not None and np.abs(255 * again - written).max() < 1.1


def test_masks_and_box_are_written(done: Path, capture: Path) -> None:
    scene, (_, truth) = load_scene(capture), table_scene(SIZE)
    for view, mask in zip(scene.train + scene.test, truth, strict=True):
        found = np.array(Image.open(done / "masks" / f"{view.name}.png")) > 127
        assert (found & mask).sum() > 0.8 * (found | mask).sum()
    written = json.loads((done / "object.json").read_text())
    assert set(written["agreement"]) == {view.name for view in scene.train}
    assert np.abs(np.array(written["box"]) - [-0.45, -0.45, TABLE, 0.45, 0.45, 0.65]).max() < 0.15


def test_single_steps_take_the_masks_up(done: Path, capture: Path) -> None:
    config = make_config(overrides=[*SHORT, *FEW, "object=auto"])
    report = json.loads((done / "report.json").read_text())
    scores = score_again(capture, done, config, "cpu")
    assert scores["psnr_test"] == pytest.approx(report["psnr_test"], abs=1e-3)
    mesh = mesh_again(capture, done, config, "cpu")
    assert len(mesh.faces) == pytest.approx(report["mesh"]["faces"], rel=2e-3)  # the files hold float32


def test_what_a_run_writes_can_be_given_back(done: Path, capture: Path, tmp_path: Path) -> None:
    given, written = tmp_path / "given", json.loads((done / "object.json").read_text())
    shutil.copytree(capture, given)
    shutil.copy(done / "object.json", given)
    place = load_scene(given).object_place
    assert place is not None and place.box.ravel().tolist() == written["box"]
    shutil.copytree(done / "masks", given / "masks")
    scene = load_scene(given)
    assert scene.masked and scene.ground is not None
    for view in scene.train + scene.test:
        np.testing.assert_array_equal(view.alpha, np.array(Image.open(done / "masks" / f"{view.name}.png")))


@pytest.mark.parametrize("setting", [None, "object_box=-0.4,-0.3,-0.2,0.4,0.5,0.6"])
def test_the_object_is_looked_for_where_a_person_says(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, setting: str | None
) -> None:
    asked = []

    def search(scene: Scene, start: object, seed: int, box: np.ndarray, ground: np.ndarray, *rest: object) -> NoObject:
        frame = scene.user_from_scene
        asked.append((frame.to_user(box), None if ground is None else frame.plane_to_user(ground)))
        return NoObject("this is a test")

    monkeypatch.setattr(preprocess, "find_object", search)
    shutil.copytree(capture, tmp_path / "given")
    file = {"box": [-0.5, -0.5, TABLE, 0.5, 0.5, 0.7], "ground": [0, 0, 1, -TABLE]}
    (tmp_path / "given" / "object.json").write_text(json.dumps(file))
    config = make_config(overrides=[*FEW, *([] if setting is None else [setting])])
    steps = Steps(StepClock(), ignore, lambda: False)
    preprocess.preprocess(load_scene(tmp_path / "given", config.data), config, tmp_path / "out", steps)
    ((box, ground),) = asked
    if setting is None:
        assert box.ravel() == pytest.approx(file["box"]) and ground == pytest.approx(file["ground"])
    else:
        assert box.ravel() == pytest.approx([-0.4, -0.3, -0.2, 0.4, 0.5, 0.6]) and ground is None


def test_another_run_takes_the_masks_over(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError("the object is known")

    monkeypatch.setattr(preprocess, "find_object", never)
    found = load_scene(capture)
    (tmp_path / "masks").mkdir()
    for view, mask in zip(found.train + found.test, table_scene(SIZE)[1], strict=True):
        Image.fromarray(255 * mask.astype(np.uint8)).save(tmp_path / "masks" / f"{view.name}.png")
    (tmp_path / "object.json").write_text(json.dumps({"ground": [0.0, 0.0, 1.0, -TABLE]}))
    steps = Steps(StepClock(), ignore, lambda: False)
    config = make_config(overrides=[*FEW, "object=auto"])
    scene, start = preprocess.preprocess(found, config, tmp_path, steps, reuse_object=True)
    assert scene.masked and scene.ground is not None and len(start.positions) > 100
    assert any("an earlier run found" in note for note in scene.notes)
    assert (tmp_path / "object.json").is_file()


def test_a_view_of_the_whole_scene_is_refused_and_its_camera_is_not(done: Path, capture: Path) -> None:
    scene, result = load_scene(capture), mgsr.load_result(done)
    with pytest.raises(ConfigError, match="the found object"):
        mgsr.render(result, scene.test[0])
    camera = scene.user_from_scene.camera_to_user(scene.test[0].camera)
    written = np.array(Image.open(done / "renders" / "test" / f"{scene.test[0].name}.png"))
    shown = mgsr.render(result, camera)
    assert np.abs(255 * shown.alpha - written[..., 3]).max() < 1.1


def test_masks_that_are_gone_are_asked_for(done: Path, capture: Path, tmp_path: Path) -> None:
    scene = load_scene(capture)
    assert with_found_object(tmp_path, scene) is scene
    (tmp_path / "object.json").write_text("{}")
    with pytest.raises(MgsrError, match=r"expected a mask of 72x72 pixels, got none"):
        with_found_object(tmp_path, scene)


def test_masks_of_a_person_are_not_replaced(capture: Path, tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "own.png").write_bytes(b"mine")
    with pytest.raises(ConfigError, match="choose another folder"):
        run_scene(capture, tmp_path, make_config(overrides=[*SHORT, *FEW, "object=auto"]), "cpu")
    assert (tmp_path / "masks" / "own.png").read_bytes() == b"mine"


@pytest.mark.slow
def test_without_an_object_all_is_reconstructed(tmp_path: Path) -> None:
    folder, out = tmp_path / "two", tmp_path / "out"
    folder.mkdir()
    write_scene(folder, table_scene(SIZE, copies=2)[0], 1.0)
    run_scene(folder, out, make_config(overrides=[*SHORT, *FEW, "object=auto"]), "cpu")
    report = json.loads((out / "report.json").read_text())
    assert not report["input"]["masked"] and not (out / "masks").exists()
    why = "everything in view is reconstructed, because no single object was found: several objects"
    assert any(why in note for note in report["input"]["notes"])


@pytest.mark.parametrize("box", ["1,2,3", "0,0,0,1,1,0", "a,b,c,d,e,f", "0,0,0,1,1,nan"])
def test_a_box_that_is_none_is_refused(box: str) -> None:
    with pytest.raises(ConfigError, match=r"data.object_box: expected x0,y0,z0,x1,y1,z1"):
        make_config(overrides=[f"object_box={box}"])
