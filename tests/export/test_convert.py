"""Conversions of meshes and splats, read back by other libraries."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.lib.recfunctions import append_fields
from plyfile import PlyData, PlyElement
from trimesh.visual import ColorVisuals

from mgsr.errors import ConfigError, MeshError, SceneError
from mgsr.export.convert import convert
from mgsr.export.gltf import UpAxis
from mgsr.export.mesh_files import write_glb, write_ply, write_textured_glb
from mgsr.export.mesh_reading import load_mesh
from mgsr.export.obj_files import write_obj
from mgsr.export.ply_notes import LOW_PASS, UNIT, read_number
from mgsr.export.splats import load_splats, write_splats
from tests.export.test_mesh_files import ball, mesh_and_colors, square
from tests.export.test_packed_splats import PLY_STEPS, SPZ_STEPS, check_close, splats


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_obj_holds_what_was_given(tmp_path: Path, offset: float) -> None:
    vertices, faces, normals, colors = ball(offset)
    write_obj(tmp_path / "a.obj", *mesh_and_colors(vertices, faces, normals, colors))
    mesh = trimesh.load_mesh(tmp_path / "a.obj", process=False, maintain_order=True)
    np.testing.assert_allclose(mesh.vertices, vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertex_normals, normals, atol=1e-5)
    assert isinstance(mesh.visual, ColorVisuals)
    np.testing.assert_allclose(mesh.visual.vertex_colors[:, :3] / 255, colors, atol=1.01 / 255)
    lines = [line.split() for line in (tmp_path / "a.obj").read_text().splitlines() if line.startswith("v ")]
    cut_off = (np.array(lines)[:, 4:].astype(float) * 255).astype(int)
    np.testing.assert_array_equal(cut_off, np.rint(colors * 255), "readers that don't round get the same levels")


@pytest.mark.parametrize("before", [".ply", ".glb", ".obj"])
@pytest.mark.parametrize("after", [".ply", ".glb", ".obj"])
def test_meshes(tmp_path: Path, before: str, after: str) -> None:
    arrays = ball()
    writers: dict[str, Callable[..., None]] = {".ply": write_ply, ".glb": write_glb, ".obj": write_obj}
    writers[before](tmp_path / f"a{before}", *mesh_and_colors(*arrays))
    assert convert(tmp_path / f"a{before}", tmp_path / f"b{after}", scale=2.0) == "a mesh of 320 faces"
    mesh = trimesh.load_mesh(tmp_path / f"b{after}", process=False)
    np.testing.assert_allclose(mesh.vertices, 2 * arrays[0], atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, arrays[1])
    np.testing.assert_allclose(load_mesh(tmp_path / f"b{after}").colors, arrays[3], atol=1.01 / 255)


@pytest.mark.parametrize("after", [".ply", ".glb", ".obj"])
def test_vertices_take_the_colours_of_a_picture(tmp_path: Path, after: str) -> None:
    """Check a square with a texel at each corner."""
    picture = np.array([[[200, 10, 20], [30, 220, 40]], [[1, 2, 250], [120, 130, 140]]], np.uint8)
    mesh, uvs, tangents, material = square(picture)
    write_textured_glb(tmp_path / "a.glb", mesh, uvs * 0.9 + 0.05, tangents, material)
    convert(tmp_path / "a.glb", tmp_path / f"b{after}")
    expected = picture[[0, 1, 1, 0], [0, 0, 1, 1]] / 255
    np.testing.assert_allclose(load_mesh(tmp_path / f"b{after}").colors, expected, atol=1.01 / 255)


def test_up(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", *mesh_and_colors(*ball()))
    convert(tmp_path / "a.ply", tmp_path / "b.glb", up=UpAxis.Z)
    given, turned = (
        trimesh.load_mesh(tmp_path / "a.ply", process=False),
        trimesh.load_mesh(tmp_path / "b.glb", process=False),
    )
    np.testing.assert_allclose(turned.vertices[:, 1], given.vertices[:, 2], atol=1e-6)


@pytest.mark.parametrize(("suffix", "steps"), [(".spz", SPZ_STEPS), (".compressed.ply", PLY_STEPS)])
def test_splats_there_and_back(tmp_path: Path, suffix: str, steps: dict[str, float]) -> None:
    write_splats(tmp_path / "a.ply", splats())
    assert convert(tmp_path / "a.ply", tmp_path / f"b{suffix}") == "40 splats"
    convert(tmp_path / f"b{suffix}", tmp_path / "c.ply", scale=1.0)
    check_close(load_splats(tmp_path / "c.ply"), splats(), steps)


def test_the_scale_of_splats(tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", splats())
    convert(tmp_path / "a.ply", tmp_path / "b.ply", scale=1000)
    read = load_splats(tmp_path / "b.ply")
    np.testing.assert_allclose(read["means"], splats()["means"] * 1000, rtol=1e-6)
    np.testing.assert_allclose(np.exp(read["log_scales"]), np.exp(splats()["log_scales"]) * 1000, rtol=1e-5)


def test_splats_keep_what_their_header_says(tmp_path: Path) -> None:
    """Check that the unit and the low-pass survive, which `mgsr evaluate` needs; the numbers stay exact."""
    write_splats(tmp_path / "a.ply", splats(), unit=0.3, low_pass=0.1)
    convert(tmp_path / "a.ply", tmp_path / "b.ply")
    convert(tmp_path / "b.ply", tmp_path / "c.ply", scale=10)
    assert [read_number(tmp_path / name, UNIT) for name in ("b.ply", "c.ply")] == [0.3, 3.0]
    assert [read_number(tmp_path / name, LOW_PASS) for name in ("b.ply", "c.ply")] == [0.1, 0.1]
    before, same, scaled = (load_splats(tmp_path / name) for name in ("a.ply", "b.ply", "c.ply"))
    assert all(np.array_equal(before[name], same[name]) for name in before)
    np.testing.assert_allclose(scaled["means"], splats()["means"] * 10, rtol=1e-6)


def test_meshes_keep_their_unit(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", *mesh_and_colors(*ball()), unit=0.3)
    convert(tmp_path / "a.ply", tmp_path / "b.ply", scale=10)
    assert read_number(tmp_path / "b.ply", UNIT) == 3.0


@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "opacity_logits", "sh"])
@pytest.mark.parametrize("target", ["b.ply", "b.compressed.ply", "b.spz"])
def test_splats_without_a_number(tmp_path: Path, name: str, target: str) -> None:
    given = splats()
    given[name][3:5] = np.nan
    write_splats(tmp_path / "a.ply", given)
    with pytest.raises(SceneError, match=rf"a\.ply: {name} of 2 of 40 splats are NaN or infinite; remove"):
        convert(tmp_path / "a.ply", tmp_path / target)


@pytest.mark.parametrize("scale", [1e-300, 1e39, 1e300])
def test_scales_that_files_can_not_hold(tmp_path: Path, scale: float) -> None:
    write_splats(tmp_path / "splats.ply", splats())
    write_ply(tmp_path / "mesh.ply", *mesh_and_colors(*ball()))
    for source, target in (
        ("splats.ply", "b.ply"),
        ("splats.ply", "b.spz"),
        ("mesh.ply", "b.ply"),
        ("mesh.ply", "b.glb"),
    ):
        with pytest.raises(
            ConfigError, match=r"--scale 1e[-+]\d+ would turn coordinates of up to .* choose a scale nearer to 1"
        ):
            convert(tmp_path / source, tmp_path / target, scale)


def test_errors_of_splats_name_the_file(tmp_path: Path) -> None:
    given = splats()
    given["log_scales"] -= 7
    write_splats(tmp_path / "a.ply", given)
    with pytest.raises(SceneError, match=r"a\.ply: .*--scale"):
        convert(tmp_path / "a.ply", tmp_path / "b.spz")
    vertex = PlyData.read(str(tmp_path / "a.ply"))["vertex"].data
    more = append_fields(vertex, [f"f_rest_{i}" for i in range(45, 72)], [np.zeros(40, "<f4")] * 27, usemask=False)
    PlyData([PlyElement.describe(more, "vertex")]).write(str(tmp_path / "d4.ply"))
    with pytest.raises(SceneError, match=r"d4\.ply: sh: expected .* \(at most degree 3\), got \[40, 25, 3\]"):
        convert(tmp_path / "d4.ply", tmp_path / "b.spz")


def test_the_light_splits_loss_is_told(tmp_path: Path) -> None:
    given = splats() | {"refl_opacity_logits": np.zeros(40, np.float32), "weight_logits": np.zeros(40, np.float32)}
    write_splats(tmp_path / "a.ply", given | {"refl_sh": np.zeros((40, 1, 3), np.float32)})
    assert convert(tmp_path / "a.ply", tmp_path / "b.spz") == "40 splats, without their reflected light"
    assert convert(tmp_path / "a.ply", tmp_path / "b.ply") == "40 splats"


def test_refusals(tmp_path: Path) -> None:
    write_splats(tmp_path / "splats.ply", splats())
    write_ply(tmp_path / "mesh.ply", *mesh_and_colors(*ball()))
    with pytest.raises(
        ConfigError, match=r"b\.obj: .*splats\.ply is read as splats; .* \.compressed\.ply, \.ply, \.spz"
    ):
        convert(tmp_path / "splats.ply", tmp_path / "b.obj")
    for name in ("b.spz", "b.compressed.ply", "b"):
        with pytest.raises(ConfigError, match=rf"{name}: .*mesh\.ply is read as a mesh; .* \.ply, \.glb, \.obj"):
            convert(tmp_path / "mesh.ply", tmp_path / name)
    with pytest.raises(ConfigError, match=r"--up z: only \.glb files are turned, and .*b\.ply keeps the frame"):
        convert(tmp_path / "splats.ply", tmp_path / "b.ply", up=UpAxis.Z)
    with pytest.raises(ConfigError, match="--scale 0: expected a number above 0"):
        convert(tmp_path / "mesh.ply", tmp_path / "b.obj", scale=0)
    with pytest.raises(ConfigError, match=r"gone\.ply: this file does not exist"):
        convert(tmp_path / "gone.ply", tmp_path / "b.obj")
    (tmp_path / "bad.obj").write_text("hello")
    with pytest.raises(MeshError, match=r"bad\.obj"):
        convert(tmp_path / "bad.obj", tmp_path / "b.ply")
