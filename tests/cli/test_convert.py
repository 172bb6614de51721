"""`mgsr convert` and `mgsr poses` on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from mgsr.cli.main import app
from mgsr.export.compressed_ply import is_compressed_ply
from mgsr.export.mesh_files import write_ply
from mgsr.export.splats import write_splats
from tests.data.captures import BallCapture
from tests.export.test_mesh_files import ball
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
    write_ply(tmp_path / "a.ply", *ball())
    given = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.glb"), "--up", "z", "--scale", "1000"]
    result = RUN.invoke(app, given)
    assert result.exit_code == 0 and "a mesh of 320 faces" in result.output


def test_scenes(tmp_path: Path) -> None:
    BallCapture(views=6).write_plain(tmp_path / "ball")
    given = ["convert", str(tmp_path / "ball"), str(tmp_path / "out")]
    result = RUN.invoke(app, given)
    assert result.exit_code == 0 and "6 training and 0 test views" in result.output
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"images", "masks", "sparse", "transforms.json"}
    assert RUN.invoke(app, given).exit_code == 2, "what is there is not written over"


def test_refusals_leave_nothing_behind(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", *ball())
    result = RUN.invoke(app, ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.spz")])
    assert result.exit_code == 2 and "error: .spz: a mesh can become one of" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_poses_without_photographs(tmp_path: Path) -> None:
    result = RUN.invoke(app, ["poses", str(tmp_path), "-o", str(tmp_path / "scene")])
    assert result.exit_code == 2 and "0 images; at least 3 are needed" in result.output
