"""`mgsr-worker run` and `mgsr` on a small capture, judged by what other libraries read from the results."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from plyfile import PlyData
from scipy.spatial import cKDTree
from typer.testing import CliRunner

from mgsr.cli.main import app
from mgsr.config import DataConfig, GaussianConfig, OutputConfig, make_config
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.export.splats import load_splats
from mgsr.pipeline.evaluation import find_truth, surface_scores
from mgsr.pipeline.result_files import read_mesh, read_models, write_models
from program.worker import app as worker_app
from tests.cli.spheres import SPHERES, write_spheres
from tests.data.reading import draw
from tests.optional import present

pytestmark = pytest.mark.usefixtures("quick_report")

SHORT = [
    *("--preset", "draft", "--set", "surfel_iterations=80", "--set", "gaussian_iterations=80"),
    *("--set", "mutual.iterations=60", "--set", "surfels.max_start=1500", "--set", "gaussians.max_start=1500"),
    *("--set", "poisson_depth=6", "--set", "exposure=keep", "--set", "gloss.height=8"),
]
# Fewer iterations, for runs whose results are not compared with what was photographed.
FEWER = ("--set", "surfel_iterations=40", "--set", "gaussian_iterations=40")
UNLIT = ("--set", "max_environment_ratio=0")  # for runs in which shading plays no part
SUFFIXES = ["", "_transmitted", "_reflected", "_weight", "_depth", "_normal"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_spheres(tmp_path_factory.mktemp("capture") / "spheres")


@pytest.fixture(scope="module")
def plain_scene(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide the same scene without the truth, whose comparison takes longer than all the rest."""
    copy = tmp_path_factory.mktemp("plain") / "spheres"
    shutil.copytree(scene, copy, ignore=shutil.ignore_patterns("mesh_gt.ply"))
    return copy


@pytest.fixture(scope="module")
def done(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide a finished run of the method itself."""
    out = tmp_path_factory.mktemp("runs") / "mgsr"
    result = CliRunner().invoke(worker_app, ["run", str(scene), "-o", str(out), *SHORT])
    assert result.exit_code == 0, result.output
    return out


def test_all_results_are_there_and_nothing_else(done: Path) -> None:
    assert {path.name for path in done.iterdir()} == {
        *("mesh.ply", "model.glb", "environment.exr", "splats_2d.ply", "splats_3d.ply", "renders"),
        *("mirrored_light.npz", "report.json", "report.html", "log.txt", "checkpoint"),
    }
    pictures = {path.name for path in (done / "renders" / "test").iterdir()}
    assert pictures == {f"r_{i}{suffix}.png" for i in range(2) for suffix in SUFFIXES}


def test_the_mesh_lies_where_the_spheres_are(done: Path) -> None:
    # In the user's frame. After so few iterations the surface is rough: 0.05 is a twelfth of the large sphere.
    for name in ("mesh.ply", "model.glb"):
        mesh = trimesh.load_mesh(done / name)
        vertices = np.asarray(mesh.vertices)
        if name == "model.glb":  # y-up
            vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
        distances = [np.linalg.norm(vertices - center, axis=1) - radius for center, radius, _ in SPHERES]
        assert np.abs(np.min(distances, axis=0)).mean() < 0.05


def test_splats_have_the_viewers_layout(done: Path) -> None:
    for name in ("splats_2d.ply", "splats_3d.ply"):
        vertex = PlyData.read(str(done / name))["vertex"]
        assert {"x", "f_dc_0", "f_rest_44", "opacity", "scale_2", "rot_3"} <= {item.name for item in vertex.properties}
        assert np.abs(np.stack([vertex[axis] for axis in "xyz"])).max() < 2


def test_renders_have_straight_alpha(done: Path, scene: Path) -> None:
    render = np.asarray(Image.open(done / "renders" / "test" / "r_0.png")) / 255
    photo = np.asarray(Image.open(scene / "test" / "r_0.png")) / 255
    assert render.shape == photo.shape
    inside = photo[..., 3] > 0.99
    assert np.abs(render - photo)[inside].mean() < 0.1
    assert render[..., 3][photo[..., 3] == 0].mean() < 0.1


def test_the_report_has_its_fields(done: Path) -> None:
    report = json.loads((done / "report.json").read_text())
    assert (report["scene"], report["preset"], report["method"]) == ("spheres", "draft", "mgsr")
    assert (report["device"], report["seed"]) == ("cpu", 0)
    assert report["iterations"]["mutual"] == {"iterations": 60, "stopped": "iterations", "dropped": 0}
    assert set(report["gaussians"]) == {"surfels", "gaussians"}
    assert report["settings"]["expert"] == asdict(make_config("draft", overrides=["gloss.height=8"]).expert)
    assert report["psnr_test"] > 20 and 0 < report["ssim_test"] < 1
    assert {"seconds", "stage", "iteration", "psnr", "surfels", "gaussians"} <= set(report["curve"][0])
    faces = trimesh.load_mesh(done / "mesh.ply", process=False).faces
    assert report["mesh"]["faces"] == len(faces) and report["mesh"]["components"] >= 1
    assert 0 < report["gt"]["chamfer"] < 0.06 and report["gt"]["normal_consistency"] > 0.8
    assert report["seconds"]["total"] >= report["seconds"]["train"] > 0
    assert report["peak_memory_mib"] > 50 and "torch" in report["versions"]
    page = (done / "report.html").read_text()
    assert "<html" in page and page.count('alt="Textured model, ') == 6
    assert "mutual 60/60" in (done / "log.txt").read_text()


@pytest.mark.parametrize(("method", "kept", "gone"), [("2dgs", "2d", "3d"), ("3dgs", "3d", "2d")])
def test_each_method_ends_with_a_mesh(plain_scene: Path, tmp_path: Path, method: str, kept: str, gone: str) -> None:
    arguments = ["run", str(plain_scene), "-o", str(tmp_path), "--method", method, *SHORT, *UNLIT, *FEWER]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert len(trimesh.load_mesh(tmp_path / "mesh.ply").faces) > 100
    assert (tmp_path / f"splats_{kept}.ply").exists() and not (tmp_path / f"splats_{gone}.ply").exists()
    assert not (tmp_path / "renders" / "test" / "r_0_transmitted.png").exists()


@pytest.mark.slow
def test_files_in_another_unit(scene: Path, done: Path, tmp_path: Path) -> None:
    """Check that every file is larger by the same factor, and is compared with the truth in the capture's unit."""
    out, like_the_run = tmp_path / "out", ["--preset", "draft", "--set", "poisson_depth=6"]
    shutil.copytree(done, out)
    loaded = load_scene(scene, DataConfig())
    write_models(out, read_models(done, loaded.user_from_scene), loaded, OutputConfig(scale=1000))
    options = ["--scale", "1000", "--up", "y", "--obj", "--texture", "64", "--faces", "1000"]
    result = CliRunner().invoke(app, ["mesh", str(scene), "-o", str(out), *like_the_run, *options])
    assert result.exit_code == 0, result.output
    before = trimesh.load_mesh(done / "mesh.ply").bounds
    for name in ("mesh.ply", "model.glb", "mesh.obj"):
        # Not turned, as the capture was said to be y-up. Splats went through float32, and the model has fewer faces.
        np.testing.assert_allclose(trimesh.load_mesh(out / name).bounds, 1000 * before, atol=30, err_msg=name)
    for name in ("splats_2d.ply", "splats_3d.ply"):
        small, large = (load_splats(folder / name) for folder in (done, out))
        np.testing.assert_allclose(large["means"], 1000 * small["means"], rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(large["log_scales"][:, :2], small["log_scales"][:, :2] + np.log(1000), atol=1e-4)
    report = json.loads((done / "report.json").read_text())
    scores = present(surface_scores(read_mesh(out), find_truth(loaded), loaded))
    assert scores["chamfer"] == pytest.approx(report["gt"]["chamfer"], rel=0.05)


def test_splats_come_back_with_the_low_pass_that_they_were_trained_with(
    scene: Path, done: Path, tmp_path: Path
) -> None:
    loaded = load_scene(scene, DataConfig())
    models = read_models(done, loaded.user_from_scene)
    assert models.gaussians is not None
    assert models.gaussians.low_pass == GaussianConfig().low_pass
    models.gaussians.low_pass = 0.3
    write_models(tmp_path, models, loaded, OutputConfig())
    assert present(read_models(tmp_path, loaded.user_from_scene).gaussians).low_pass == 0.3


def test_renders_as_a_scene_for_other_programs(scene: Path, done: Path, tmp_path: Path) -> None:
    out, folder = tmp_path / "out", tmp_path / "scene"
    shutil.copytree(done, out)
    arguments = ["render", str(scene), "-o", str(out), "--as-scene", str(folder)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    given, written = load_scene(scene, DataConfig()), load_scene(folder, DataConfig())
    assert written.masked
    distances, _ = cKDTree(_centers(written)).query(_centers(given))
    assert distances.max() < 1e-6 and len(_centers(written)) == len(_centers(given))
    render = np.asarray(Image.open(done / "renders/test/r_0_transmitted.png"))
    np.testing.assert_array_equal(np.asarray(Image.open(folder / "images/test_r_0.png")), render[..., :3])
    assert CliRunner().invoke(app, arguments).exit_code == 2, "a scene that is there is left alone"


def _centers(scene: Scene) -> np.ndarray:
    """Return the cameras' positions in the user's frame."""
    views = [*scene.train, *scene.test]
    return np.array([scene.user_from_scene.camera_to_user(view.camera).center for view in views])


@pytest.mark.slow
def test_single_steps_repeat_what_the_run_did(scene: Path, done: Path) -> None:
    report = json.loads((done / "report.json").read_text())
    before = (done / "mesh.ply").read_bytes()
    like_the_run = ["--preset", "draft", "--set", "poisson_depth=6"]
    result = CliRunner().invoke(app, ["mesh", str(scene), "-o", str(done), *like_the_run])
    assert result.exit_code == 0, result.output
    # The splats went through float32 in another frame, so the meshes differ by rounding.
    assert abs(len((done / "mesh.ply").read_bytes()) / len(before) - 1) < 0.1
    assert CliRunner().invoke(app, ["render", str(scene), "-o", str(done)]).exit_code == 0
    scores = json.loads(CliRunner().invoke(app, ["evaluate", str(scene), "-o", str(done)]).stdout)
    assert scores["psnr_test"] == pytest.approx(report["psnr_test"], abs=0.05)
    assert scores["gt"]["chamfer"] == pytest.approx(report["gt"]["chamfer"], rel=0.1)


def test_info_of_photographs_without_cameras_searches_for_none(tmp_path: Path) -> None:
    for number in range(4):
        draw(tmp_path / f"vase/{number}.png")
    result = CliRunner().invoke(app, ["info", str(tmp_path / "vase")])
    assert result.exit_code == 0, result.output
    reported = dict(line.split(maxsplit=1) for line in result.output.splitlines())
    assert (reported["format"], reported["files"], reported["cameras"][:4]) == ("photographs", "4", "none")


def test_info_tells_what_was_read(scene: Path) -> None:
    result = CliRunner().invoke(app, ["info", str(scene)])
    assert result.exit_code == 0
    assert "blender" in result.stdout and "64, 64" in result.stdout


def test_sigterm_leaves_a_checkpoint_and_says_how_to_go_on(scene: Path, tmp_path: Path) -> None:
    """Check that SIGTERM leaves a checkpoint, in a process of its own, because signals go to processes."""
    command = [sys.executable, "-m", "program.worker", "run", str(scene), "-o", str(tmp_path)]
    endless = ["--method", "2dgs", *SHORT, *UNLIT, "--set", "surfel_iterations=100000", "--set", "report_every=5"]
    process = subprocess.Popen(
        [*command, *endless], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    )
    wait_for(lambda: "warmup_surfels 20/" in read(tmp_path / "log.txt"), process)
    os.kill(process.pid, signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "--resume" in errors and (tmp_path / "checkpoint").exists()
    assert not (tmp_path / "report.json").exists()


def test_resume_takes_up_a_finished_training(scene: Path, done: Path, tmp_path: Path) -> None:
    (tmp_path / "checkpoint").write_bytes((done / "checkpoint").read_bytes())
    arguments = ["train", str(scene), "-o", str(tmp_path), "--resume", *SHORT]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    for name in ("splats_2d.ply", "splats_3d.ply"):
        assert (tmp_path / name).read_bytes() == (done / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: this folder or file does not exist"),
        pytest.param(
            ["SCENE", "--device", "cuda"],
            "device cuda: the installed torch",
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here"),
        ),
        (["SCENE", "--device", "tpu"], "auto, cpu, cuda"),
        (["SCENE", "--preset", "best"], "draft, standard, high"),
        (["SCENE", "--set", "mask=off"], "masks"),
        (["EMPTY"], "the folder is empty"),
    ],
)
def test_bad_input_is_one_message_and_code_2(scene: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    (tmp_path / "empty").mkdir()
    named = {"SCENE": str(scene), "EMPTY": str(tmp_path / "empty")}
    out = tmp_path / "out"
    result = CliRunner().invoke(worker_app, ["run", *(named.get(word, word) for word in arguments), "-o", str(out)])
    assert result.exit_code == 2
    assert message in result.stderr and "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not out.exists()


def test_steps_without_their_input_say_which_command_makes_it(scene: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["mesh", str(scene), "-o", str(tmp_path)])
    assert result.exit_code == 2 and "mgsr train" in result.stderr


def read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 60) -> None:
    """Wait until the condition holds; fail when the process ends or the time is over first."""
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.05)
