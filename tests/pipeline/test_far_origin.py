"""A capture whose frame has its origin far away, as maps have it: what the run wrote is what later commands read."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from plyfile import PlyData, PlyElement
from typer.testing import CliRunner

import mgsr
from mgsr.cli.main import app
from mgsr.config import Config, DataConfig, OutputConfig
from mgsr.data.camera import Camera
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene, Similarity, View
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.pipeline.evaluation import find_truth, surface_scores
from mgsr.pipeline.report_pictures import draw_surface
from mgsr.pipeline.result_files import read_models, with_irradiance, write_lighting, write_models
from mgsr.pipeline.run import _draw
from mgsr.shading.lighting import Lighting
from tests.cli.spheres import SPHERES, held_out_camera, write_spheres
from tests.cli.test_run import SHORT, UNLIT
from tests.export.test_flash import lighting
from tests.mesh.shapes import looking_at_origin

AWAY = np.array([512345.25, 4501234.5, 431.25])
ORIGIN = "512345 4501235 431"
NOTE = f"the frame's origin lies 4,500,000 units away, so splat files have positions relative to {ORIGIN}"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_spheres(tmp_path_factory.mktemp("capture") / "spheres", size=48, train=10, test=1)
    (folder / "mesh_gt.ply").unlink()
    move_cameras(folder, AWAY)
    return folder


def move_cameras(folder: Path, away: np.ndarray) -> None:
    for path in folder.glob("transforms_*.json"):
        content = json.loads(path.read_text())
        for frame in content["frames"]:
            pose = np.array(frame["transform_matrix"])
            pose[:3, 3] += away
            frame["transform_matrix"] = pose.tolist()
        path.write_text(json.dumps(content))


def write_truth(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a PLY with double positions by plyfile."""
    vertex = np.rec.fromarrays(vertices.T, dtype=[(axis, "f8") for axis in "xyz"])
    face = np.empty(len(faces), [("vertex_indices", "i4", (3,))])
    face["vertex_indices"] = faces
    PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")]).write(str(path))


@pytest.fixture(scope="module")
def done(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "far"
    result = CliRunner().invoke(app, ["run", str(capture), "-o", str(out), *SHORT, *UNLIT])
    assert result.exit_code == 0, result.output
    return out


def test_the_origin_is_named_in_the_report_and_told_once(done: Path) -> None:
    read = json.loads((done / "report.json").read_text())["input"]
    assert " ".join(f"{value:.0f}" for value in read["splats_origin"]) == ORIGIN
    assert [note for note in read["notes"] if NOTE in note]
    assert (done / "log.txt").read_text().count(NOTE) == 1
    for name in ("splats_2d.ply", "splats_3d.ply"):
        assert f"mgsr origin {ORIGIN}" in PlyData.read(str(done / name)).comments


def test_info_tells_it(capture: Path) -> None:
    assert NOTE in CliRunner().invoke(app, ["info", str(capture)]).output


def test_splats_lie_on_the_spheres(done: Path) -> None:
    vertex = PlyData.read(str(done / "splats_2d.ply"))["vertex"]
    places = np.stack([vertex[axis].astype(float) for axis in "xyz"], 1) + np.array(ORIGIN.split(), float) - AWAY
    gaps = np.min([np.abs(np.linalg.norm(places - center, axis=1) - radius) for center, radius, _ in SPHERES], axis=0)
    assert np.median(gaps) < 0.03


def test_python_has_it_in_the_captures_frame(capture: Path, done: Path) -> None:
    result = mgsr.load_result(done)
    assert " ".join(f"{value:.0f}" for value in result.origin) == ORIGIN
    assert result.surfels is not None
    places = result.surfels.means.numpy() + result.origin - AWAY
    gaps = np.min([np.abs(np.linalg.norm(places - center, axis=1) - radius) for center, radius, _ in SPHERES], axis=0)
    assert np.median(gaps) < 0.03 and np.abs(result.mesh.vertices - AWAY).max() < 1.2
    image = mgsr.render(result, held_out_camera(capture, 0, 48))
    picture = np.asarray(Image.open(done / "renders/test/r_0.png")) / 255
    # Poses so far away have a millionth of the scene's size less; the rest is half a level of the file.
    assert np.abs(image.alpha - picture[..., 3]).max() < 0.02
    assert np.abs(image.color - picture[..., :3])[picture[..., 3] > 0.1].max() < 0.02


def test_later_commands_see_what_the_run_saw(capture: Path, done: Path, tmp_path: Path) -> None:
    report = json.loads((done / "report.json").read_text())
    shutil.copytree(done, tmp_path / "out")
    result = CliRunner().invoke(app, ["evaluate", str(capture), "-o", str(tmp_path / "out")])
    assert json.loads(result.output)["psnr_test"] == pytest.approx(report["psnr_test"], abs=0.01)
    like_the_run = ["--preset", "draft", "--set", "poisson_depth=6", *UNLIT]
    result = CliRunner().invoke(app, ["mesh", str(capture), "-o", str(tmp_path / "out"), *like_the_run])
    assert result.exit_code == 0, result.output
    before, again = (trimesh.load_mesh(folder / "mesh.ply") for folder in (done, tmp_path / "out"))
    np.testing.assert_allclose(again.bounds, before.bounds, rtol=0, atol=0.01)
    # About its middle: the volume is a sum of products of three lengths.
    volumes = [mesh.apply_translation(-AWAY).volume for mesh in (before, again)]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.01)


@pytest.mark.parametrize("scale", [1.0, 0.001])
def test_models_come_back_to_float32_precision(tmp_path: Path, scale: float) -> None:
    random = np.random.default_rng(0)
    shapes = {"means": (50, 3), "quats": (50, 4), "log_scales": (50, 2), "opacity_logits": (50,), "sh": (50, 4, 3)}
    arrays = {name: torch.from_numpy(random.uniform(-1, 1, shape).astype(np.float32)) for name, shape in shapes.items()}
    scene = Scene("far", tmp_path, "plain", [], [], None, Similarity(0.954, AWAY))
    write_models(tmp_path, TrainedModel(SurfelModel(**arrays), None), scene, OutputConfig(scale=scale))
    read = read_models(tmp_path, scene.user_from_scene).surfels
    assert read is not None
    np.testing.assert_allclose(read.means, arrays["means"], rtol=0, atol=3e-7)
    np.testing.assert_allclose(read.log_scales, arrays["log_scales"], rtol=0, atol=2e-6)


def test_a_flash_keeps_its_surface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Lighting] = []

    def lit(scene: Scene, flash: Lighting) -> Scene:
        found.append(flash)
        return scene

    monkeypatch.setattr("mgsr.pipeline.result_files.add_irradiance", lit)
    scene = Scene("far", tmp_path, "plain", [], [], None, Similarity(0.954, AWAY))
    write_lighting(tmp_path, lighting(), scene)
    with_irradiance(tmp_path, scene, Config())
    np.testing.assert_allclose(found[0].mesh.vertices, lighting().mesh.vertices, rtol=0, atol=3e-7)


@pytest.mark.slow
def test_the_reports_pictures_are_those_of_the_same_scene_at_the_origin() -> None:
    ball = trimesh.creation.icosphere(3, 0.7)
    views = [View("a", looking_at_origin(np.array([1.0, 2.0, 2.0])), np.zeros((2, 2, 3), np.uint8))]
    pictures = []
    for away in (np.zeros(3), np.array([512345.0, 4501234.0, 431.0])):
        scene = Scene("ball", Path(), "plain", views, [], None, Similarity(1.0, away))
        mesh = ReconstructedMesh(ball.vertices + away, ball.faces, np.full(ball.vertices.shape, 0.5))
        mesh = mesh.with_normals(ball.vertex_normals)
        pictures.append([side.pixels for side in _draw(mesh, None, scene).sides.shaded])
    assert len(pictures[0]) == 4
    for near, far in zip(*pictures, strict=True):
        assert (near[..., 3] == 255).sum() > 10000
        assert np.abs(near.astype(int) - far).mean() < 0.5


def test_scores_against_a_truth_are_those_of_the_same_scene_at_the_origin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("surface.POINTS", "surface.DENSE", "truth.POINTS"):
        monkeypatch.setattr(f"mgsr.metrics.{name}", 30_000)
    scores, counts = [], []
    for name, away in (("near", np.zeros(3)), ("far", AWAY)):
        folder = write_spheres(tmp_path / name, size=64, train=8, test=2)
        move_cameras(folder, away)
        spheres = trimesh.load_mesh(folder / "mesh_gt.ply", process=False)
        write_truth(folder / "mesh_gt.ply", spheres.vertices + away, spheres.faces)
        colors = np.full(spheres.vertices.shape, 0.5)
        larger = ReconstructedMesh(1.02 * spheres.vertices + away, spheres.faces, colors)
        scene = load_scene(folder, DataConfig())
        truth = find_truth(scene)
        assert truth is not None
        scores.append(surface_scores(larger, truth, scene))
        counts.append(truth.view_counts)
    assert scores[1] == pytest.approx(scores[0], rel=1e-3, abs=1e-3)
    # Where two spheres meet, points lie as near to a surface as float32 can tell.
    assert (counts[0] != counts[1]).mean() < 1e-3


def test_the_pictures_do_not_depend_on_the_frame_in_which_a_scene_is_trained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that a mesh and camera of the user's frame look the same whatever the scene's frame.

    A user's position is scale * position + offset.
    """
    monkeypatch.setattr("mgsr.report.shading.OCCLUSION_RAYS", 8)
    scale, offset, place = 0.4, np.array([3.0, -1.0, 0.5]), np.array([1.0, 2.0, 2.0])
    box = trimesh.creation.box((1.0, 0.5, 0.3))
    corners = np.asarray(box.vertices)
    mesh = ReconstructedMesh(scale * corners + offset, box.faces, np.full(corners.shape, 0.5))
    mesh = mesh.with_normals(box.vertex_normals)
    camera = looking_at_origin(place)
    rotation, pose = camera.cam_from_world[:3, :3], np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ (scale * place + offset)
    of_user = Camera(camera.K, pose, camera.width, camera.height)
    drawn = []
    for view, frame in ((camera, Similarity(scale, offset)), (of_user, Similarity(1.0, np.zeros(3)))):
        scene = Scene("box", Path(), "plain", [View("a", view, np.zeros((2, 2, 3), np.uint8))], [], None, frame)
        drawn.append([side.pixels.astype(int) for side in draw_surface(mesh, None, scene).sides.shaded])
    for moved, plain in zip(*drawn, strict=True):
        assert np.abs(moved - plain).mean() < 0.05
