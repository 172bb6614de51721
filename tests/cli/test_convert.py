"""`mgsr convert` and `mgsr poses` on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from mgsr.cli.main import app
from mgsr.config import OutputConfig
from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View
from mgsr.export.compressed_ply import is_compressed_ply
from mgsr.export.mesh_files import write_ply
from mgsr.export.splats import write_splats
from mgsr.mesh.surface import TexturedMesh
from mgsr.pipeline.result_files import write_textured
from mgsr.shading.material import Material
from tests.data.captures import BallCapture
from tests.export.test_mesh_files import ball, mesh_and_colors
from tests.export.test_packed_splats import splats

RUN = CliRunner()


@pytest.mark.parametrize("name", ["b.spz", "b.compressed.ply", "b.ply"])
def test_splats(tmp_path: Path, name: str) -> None:
    write_splats(tmp_path / "a.ply", splats())
    result = RUN.invoke(app, ["convert", str(tmp_path / "a.ply"), str(tmp_path / name)])
    assert result.exit_code == 0 and f"{name}: 40 splats" in result.output
    assert is_compressed_ply(tmp_path / name) == ("compressed" in name)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted({"a.ply", name})


def test_meshes_with_options(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", *mesh_and_colors(*ball()))
    for up in ("y", "z", "-y", "-z"):
        given = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.glb"), "--up", up, "--scale", "1000"]
        result = RUN.invoke(app, given)
        assert result.exit_code == 0 and "a mesh of 320 faces" in result.output


@pytest.mark.parametrize(("axis", "sign"), [(1, 1), (1, -1), (2, 1), (2, -1)])
def test_results_stand_upright(tmp_path: Path, axis: int, sign: int) -> None:
    """Check that a mesh stands upright under level cameras.

    The upper side of their pictures is the frame's axis, and the mesh is a triangle that points there.
    """
    up, side = sign * np.eye(3)[axis], np.eye(3)[0]
    pose = np.eye(4)
    pose[:3, :3] = [side, -up, np.cross(side, -up)]
    view = View("a", Camera(np.eye(3), pose, 2, 2), np.zeros((2, 2, 3), np.uint8), None)
    scene = Scene("a", Path(), "plain", [view], [], None, Similarity())
    corners = np.array([[0.0, 0, 0], [1, 0, 0], 3 * up])
    flat, white = np.full((4, 4, 3), (128, 128, 255), np.uint8), np.full((4, 4), 255, np.uint8)
    uvs, tangents = np.array([[0.0, 0], [1, 0], [0, 1]]), np.tile([*side, 1], (3, 1))
    model = TexturedMesh(corners, np.array([[0, 1, 2]]), uvs, tangents, (4, 4), flat, flat, white, Material())
    write_textured(tmp_path, [model.with_normals(np.tile(np.cross(side, up), (3, 1)))], scene, OutputConfig())
    written = trimesh.load_scene(tmp_path / "model.glb", process=False).to_mesh()
    np.testing.assert_allclose(written.vertices, [[0, 0, 0], [1, 0, 0], [0, 3, 0]], atol=1e-6)


def test_scenes(tmp_path: Path) -> None:
    BallCapture(views=6).write_plain(tmp_path / "ball")
    given = ["convert", str(tmp_path / "ball"), str(tmp_path / "out")]
    result = RUN.invoke(app, given)
    assert result.exit_code == 0 and "6 training and 0 test views" in result.output
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"images", "masks", "sparse", "transforms.json"}
    assert RUN.invoke(app, given).exit_code == 2, "what is there is not written over"


def test_refusals_leave_nothing_behind(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", *mesh_and_colors(*ball()))
    result = RUN.invoke(app, ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.spz")])
    assert (
        result.exit_code == 2
        and f"error: {tmp_path / 'b.spz'}: {tmp_path / 'a.ply'} is read as a mesh" in result.output
    )
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("photos.ply", "photos.ply: expected a file to write, found a folder"),
        ("here.ply", "here.ply: this folder is or contains the current folder"),
        (".", ".: "),
        ("..", "..: "),
        ("/", "/: "),
        ("", ".: "),
    ],
)
def test_folders_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str, message: str) -> None:
    here = tmp_path / "here.ply"
    (here / "photos.ply").mkdir(parents=True)
    (here / "photos.ply" / "a.jpg").write_text("kept")
    write_ply(here / "a.ply", *mesh_and_colors(*ball()))
    monkeypatch.chdir(here)
    result = RUN.invoke(app, ["convert", "a.ply", "../here.ply" if target == "here.ply" else target])
    assert result.exit_code == 2 and message in result.output and "Traceback" not in result.output
    assert (here / "photos.ply" / "a.jpg").read_text() == "kept"
    assert sorted(path.name for path in here.iterdir()) == ["a.ply", "photos.ply"]


@pytest.mark.parametrize("name", ["d.zip", "scene.ply", "full", "file", ".", "/"])
def test_scenes_need_a_new_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    BallCapture(views=6).write_plain(tmp_path / "ball")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.jpg").write_text("kept")
    (tmp_path / "file").write_text("kept")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    target = name if name in (".", "/") else str(tmp_path / name)
    result = RUN.invoke(app, ["convert", str(tmp_path / "ball"), target])
    assert result.exit_code == 2 and f"error: {target}: " in result.output
    assert (tmp_path / "full" / "a.jpg").read_text() == (tmp_path / "file").read_text() == "kept"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball", "empty", "file", "full"]


def test_up_is_only_for_glb(tmp_path: Path) -> None:
    BallCapture(views=6).write_plain(tmp_path / "ball")
    write_splats(tmp_path / "a.ply", splats())
    for given in (("a.ply", "b.ply"), ("ball", "b")):
        result = RUN.invoke(app, ["convert", *(str(tmp_path / name) for name in given), "--up", "z"])
        assert result.exit_code == 2 and "error: --up z: " in result.output


def test_poses_without_photographs(tmp_path: Path) -> None:
    result = RUN.invoke(app, ["poses", str(tmp_path), "-o", str(tmp_path / "scene")])
    assert result.exit_code == 2 and "0 images, but at least 3 are needed" in result.output
