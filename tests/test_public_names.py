"""`import mgsr`: which names it has, that they load late, and that they give what the command line writes."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import mgsr
from mgsr.cli.main import app
from tests.cli.spheres import held_out_camera, write_spheres

pytestmark = pytest.mark.usefixtures("quick_report")

ROOT = Path(__file__).resolve().parents[1]
NAMES = {
    *(
        "load_scene",
        "inspect_scene",
        "Inspection",
        "reconstruct",
        "load_result",
        "render",
        "make_config",
        "__version__",
    ),
    *("Reconstruction", "Rendering", "Mesh", "ReconstructedMesh", "Inspection"),
    *("TrainedModel", "SurfelModel", "GaussianModel", "EnvironmentMap", "Lighting", "LightKind", "Event"),
    *("Similarity", "ReportData", "StepReport", "ResultPaths"),
    *("Scene", "View", "Camera", "Config", "DataConfig"),
    *("MgsrError", "SceneError", "MissingPhotoError", "ArchiveError", "ConfigError", "TensorError", "TrainingError"),
    *("MeshError", "CheckpointError", "GpuError", "LostGpuError", "Cancelled"),
}
FEW = {
    "surfel_iterations": 40,
    "gaussian_iterations": 40,
    "mutual.iterations": 30,
    "gloss.height": 8,
    "exposure": "keep",
    "surfels.max_start": 1000,
    "gaussians.max_start": 1000,
    "poisson_depth": 5,
}
SEED = 3


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_spheres(tmp_path_factory.mktemp("capture") / "spheres", size=48, train=12, test=2)
    (folder / "mesh_gt.ply").unlink()
    return folder


@pytest.fixture(scope="module")
def scene(capture: Path) -> mgsr.Scene:
    return mgsr.load_scene(capture)


@pytest.fixture(scope="module")
def events() -> list[mgsr.Event]:
    return []


@pytest.fixture(scope="module")
def result(
    scene: mgsr.Scene, events: list[mgsr.Event], tmp_path_factory: pytest.TempPathFactory
) -> mgsr.Reconstruction:
    out = tmp_path_factory.mktemp("results") / "python"
    return mgsr.reconstruct(scene, out, "draft", device="cpu", seed=SEED, overrides=FEW, progress=events.append)


def picture(result: mgsr.Reconstruction, name: str) -> np.ndarray:
    return np.asarray(Image.open(result.paths.renders / f"{name}.png")).astype(np.float64)


def test_the_names() -> None:
    assert set(mgsr.__all__) == NAMES and mgsr.__all__ == sorted(mgsr.__all__)
    assert set(dir(mgsr)) >= NAMES
    for name in NAMES:
        assert getattr(mgsr, name) is not None
    misspelt = "loadscene"
    with pytest.raises(AttributeError, match="'mgsr' has no attribute 'loadscene'"):
        getattr(mgsr, misspelt)


def test_type_checkers_see_the_same_names_where_they_are() -> None:
    tree = ast.parse((ROOT / "mgsr/__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {name.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for name in node.names}
    assert set(seen) == NAMES - {"__version__"}
    assert seen == {name: mgsr._MODULES.get(name, "mgsr.errors") for name in seen}
    assert (ROOT / "mgsr/py.typed").is_file()


def test_the_page_has_every_name() -> None:
    page = (ROOT / "docs/python.md").read_text(encoding="utf-8").split("## All names")[1]
    assert not [name for name in NAMES if f"`{name}`" not in page and f"`{name}(" not in page]


def test_importing_it_imports_nothing_else() -> None:
    code = "import sys, mgsr\nassert not {'torch', 'numpy', 'mgsr.config'} & set(sys.modules)\nmgsr.ConfigError"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, timeout=120)


@pytest.mark.slow
def test_a_loaded_scene_gives_the_files_of_the_command_line(
    result: mgsr.Reconstruction, capture: Path, tmp_path: Path
) -> None:
    settings = [word for name, value in FEW.items() for word in ("--set", f"{name}={value}")]
    words = ["run", str(capture), "-o", str(tmp_path), "--preset", "draft", "--device", "cpu", "--seed", str(SEED)]
    ran = CliRunner().invoke(app, [*words, *settings])
    assert ran.exit_code == 0, ran.output
    theirs = {path.relative_to(tmp_path): path for path in tmp_path.rglob("*") if path.is_file()}
    ours = {path.relative_to(result.paths.folder) for path in result.paths.folder.rglob("*") if path.is_file()}
    assert ours == set(theirs)
    for name, path in theirs.items():
        if name.name not in ("report.json", "report.html", "log.txt", "checkpoint"):
            assert path.read_bytes() == (result.paths.folder / name).read_bytes(), name
    reports = [json.loads(path.read_text()) for path in (tmp_path / "report.json", result.paths.report)]
    for report in reports:
        for measured in ("seconds", "command", "peak_memory_mib", "decisions"):
            del report[measured]
        for row in (*report["curve"], *report["mesh_steps"].values()):
            del row["seconds"]
    assert reports[0] == reports[1]


def test_a_result_is_what_its_files_say(result: mgsr.Reconstruction) -> None:
    again = mgsr.load_result(str(result.paths.folder))
    report = json.loads(result.paths.report.read_text())
    assert len(result.mesh.faces) == report["mesh"]["faces"] and len(again.mesh.faces) == len(result.mesh.faces)
    assert result.surfels is not None and result.gaussians is not None
    assert {"surfels": len(result.surfels), "gaussians": len(result.gaussians)} == report["gaussians"]
    assert result.report.psnr_test == report["psnr_test"] and not result.origin.any()
    # The largest sphere is about the frame's origin, with a radius of 0.6; the splats of the surface lie on the three.
    assert np.abs(result.mesh.vertices).max() < 1.1 and np.abs(result.surfels.means.numpy()).max() < 1.3


def test_a_run_tells_how_it_goes(result: mgsr.Reconstruction, events: list[mgsr.Event]) -> None:
    steps = list(dict.fromkeys(event.step for event in events))
    assert [step for step in ("load", "start", "train", "mesh", "render", "report") if step in steps] == [
        *("load", "start", "train", "mesh", "render", "report")
    ]
    assert any(event.training is not None for event in events) and result.paths.log.read_text()


@pytest.mark.parametrize("by", ["view", "camera"])
def test_a_render_is_the_picture_on_the_disk(
    by: str, result: mgsr.Reconstruction, scene: mgsr.Scene, capture: Path
) -> None:
    image = mgsr.render(result, scene.test[1] if by == "view" else held_out_camera(capture, 1, 48))
    # Half a level is the file's rounding, the rest float32's.
    rgba = picture(result, "r_1") / 255
    alpha = rgba[..., 3]
    assert np.abs(image.alpha - alpha).max() < 0.51 / 255
    assert np.abs(image.color - rgba[..., :3])[alpha > 0.1].max() < 0.55 / 255
    file = Image.open(result.paths.renders / "r_1_depth.png")
    depth = np.asarray(file) * float(file.info["depth_scale"])
    assert np.abs(image.depth - depth).max() < 1e-3 and 1.9 < depth[24, 24] < 2.7
    normal = picture(result, "r_1_normal")[..., :3] / 127.5 - 1
    assert np.abs(image.normal - normal)[alpha > 0.1].max() < 0.02
    if image.transmitted is not None:
        assert np.abs(image.transmitted - picture(result, "r_1_transmitted")[..., :3] / 255)[alpha > 0.1].max() < 0.01
    for array in (image.color, image.alpha, image.depth, image.normal):
        assert array.dtype == np.float32


def test_a_render_has_its_cameras_size(result: mgsr.Reconstruction, capture: Path) -> None:
    image = mgsr.render(result, held_out_camera(capture, 0, 48).resized(30, 20))
    assert image.color.shape == image.normal.shape == (20, 30, 3) and image.alpha.shape == image.depth.shape == (20, 30)


def test_what_does_not_fit_is_refused(result: mgsr.Reconstruction, scene: mgsr.Scene, tmp_path: Path) -> None:
    with pytest.raises(mgsr.ConfigError, match="scene: expected a Scene or a path, got int"):
        mgsr.reconstruct(5, tmp_path)  # type: ignore[arg-type]
    with pytest.raises(mgsr.ConfigError, match=r"data\.masks: spheres is loaded with auto, got off"):
        mgsr.reconstruct(scene, tmp_path / "new", overrides={"masks": "off"})
    with pytest.raises(mgsr.ConfigError, match=r"option .masc. does not exist; did you mean data\.masks"):
        mgsr.reconstruct(scene, tmp_path / "new", overrides={"masc": "off"})
    with pytest.raises(mgsr.ConfigError, match="got 'masks=off'"):
        mgsr.make_config(overrides="masks=off")
    with pytest.raises(mgsr.ConfigError, match="device 'tpu': expected one of auto, cpu, cuda"):
        mgsr.reconstruct(scene, tmp_path / "new", device="tpu")
    with pytest.raises(mgsr.MgsrError, match=r"report\.json: expected the report of a finished run"):
        mgsr.load_result(tmp_path)
    with pytest.raises(mgsr.Cancelled):
        mgsr.reconstruct(scene, tmp_path / "new", should_stop=lambda: True)


def test_a_camera_that_is_none_is_refused(result: mgsr.Reconstruction, capture: Path) -> None:
    camera = held_out_camera(capture, 0, 48)
    with pytest.raises(mgsr.ConfigError, match=r"camera: expected a Camera or a View, got ndarray"):
        mgsr.render(result, camera.K)  # type: ignore[arg-type]
    with pytest.raises(mgsr.TensorError, match=r"camera.K: expected \[3, 3\]"):
        mgsr.render(result, mgsr.Camera(camera.K[:2], camera.cam_from_world, 48, 48))
    with pytest.raises(mgsr.TensorError, match="expected a rotation and a translation"):
        mgsr.render(result, mgsr.Camera(camera.K, 2 * camera.cam_from_world, 48, 48))
    with pytest.raises(mgsr.TensorError, match="0 x 48"):
        mgsr.render(result, mgsr.Camera(camera.K, camera.cam_from_world, 0, 48))
